"""One UAV: estimation, control, modes, MAVLink services, and the on-board application.

`vehicle` composes the other packages into one step of simulated time, `process` runs vehicles as processes.
Physics and sensor models are left to `harness.world`, the channel to `netsim`.
"""

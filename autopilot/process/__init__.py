"""Processes of one UAV: the prefork server, the companion beside a PX4, the warm-up of compiled kernels.

``python -m autopilot`` is `autopilot.__main__`. What a vehicle does in a step is left to `autopilot.vehicle`.
"""

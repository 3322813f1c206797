"""One vehicle: vehicle, host, compiled fast step, pilot, monitor and messaging.

Import `host.Host` for a vehicle with its links, `vehicle.Vehicle` for one without. This package composes the
other packages of `autopilot`; processes are in `autopilot.process` and
`autopilot.__main__`, UDP sockets in `autopilot.mavlink.udp_socket`.
"""

"""One vehicle in a step of simulated time: vehicle, its host, its fast step, pilot, monitor and messaging.

Import `host.Host` for a vehicle with its links, `vehicle.Vehicle` without. It composes all other rooms of
`autopilot`; sockets and processes are left to `autopilot.process` and `autopilot.__main__`.
"""

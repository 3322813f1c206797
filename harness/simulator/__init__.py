"""One step of everything: physics server, lockstep with the vehicles, HIL messages, emulator client.

Import `simulation.Simulation` for the core, `server` for the process, which
`harness.launch` starts.
"""

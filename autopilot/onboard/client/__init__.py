"""The client of the autopilot that applications share: state, commands, kinds of autopilots. No I/O.

Import `own_state` for position and mode, `commands` for repeated commands, `autopilots` for the differences
between PX4 and ArduPilot.
"""

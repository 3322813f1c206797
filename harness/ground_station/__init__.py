"""The process of a ground station on the radio: relays datagrams between its radio and programs over UDP.

Import `settings` for the process's settings, `relay` for the core. Programs see the ports of a run with
telemetry by wire. MAVLink is not parsed here: that is left to `autopilot.mavlink` and the programs.
"""

"""Network interfaces of vehicles for unmodified programs, and the process that hosts both.

Each vehicle has a network namespace with an interface ``wlan0``, whose frames cross the emulated channel
(`netsim.wire.packets`). ``python -m netsim.network`` is the process; import `messages` for its settings,
commands and events, `namespaces.why_not` for whether the system permits it, and `vehicle_entry` to run a
command on a vehicle. The channel is left to `netsim.emulator`.
"""

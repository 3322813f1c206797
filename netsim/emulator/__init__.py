"""The emulated channel as a whole, without I/O: items in, time advances, deliveries out.

Import `interface` for what an emulator provides, `service` for a run's emulator with its logs,
`emulator.Emulator` for the channel alone. Processes and Zenoh are left to `netsim.transport`.
"""

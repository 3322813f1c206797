"""The emulator's process and its clients: Zenoh, the stream of intervals, radios of vehicles and of guests.

Import `lockstep_radio` in a vehicle, `asynchronous_radio` or `guest` elsewhere. Messages are `netsim.wire`'s.
"""

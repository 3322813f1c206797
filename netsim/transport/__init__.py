"""The emulator process and its clients: Zenoh, the interval stream, radios of vehicles and of guests.

Import `lockstep_radio` in a vehicle, `asynchronous_radio` or `guest` elsewhere. `packet_exchange` serves the
host of network interfaces.
"""

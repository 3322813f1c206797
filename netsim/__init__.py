"""The emulated 802.11 channel: propagation, medium access, Fine Time Measurement, and the emulator's clients.

`phy`, `mac` and `ftm` share the state in `model`; `emulator` composes them without I/O, and `transport` runs
it as a process over Zenoh. Vehicles and companions import `wire` and the clients in `transport` only.
"""

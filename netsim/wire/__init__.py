"""Messages between radios, emulator and time master: `messages` of the radio, `lockstep` of the intervals.

`packets` are those of network interfaces, `addresses` those of stations. Imports no other folder of `netsim`.
They are sent by `netsim.transport`.
"""

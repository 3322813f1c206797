"""Messages between radios, emulator and time master: `messages` of the radio, `lockstep` of the intervals.

Imports no other folder of `netsim`. They are sent by `netsim.transport`.
"""

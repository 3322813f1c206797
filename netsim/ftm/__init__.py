"""Fine Time Measurement (IEEE 802.11-2016, 11.24.6): sessions of frames that contend for the channel.

`initiator`, `responder` and `session` are the states, `negotiation` and `elements` the bytes, `stamps` the
clocks and the noise of time stamps. When to range to which station is decided in `autopilot.onboard.radio`.
"""

"""Two-way ranging by ultra-wideband radios (HRP UWB PHY of IEEE 802.15.4) beside the 802.11 channel, no I/O.

`exchanges.UwbRadios` is the interface; `config` has the settings. `frames` has the air times, `clock` the
time stamps, `time_of_flight` the estimators, `reception` packet errors and time-stamp noise, `link_budget`
the received powers, `medium` overlapping frames, `access` the starts of exchanges. The emulator gives
requests to it with ``onboard.ranging_radio = "uwb"``; datagrams are left to `netsim.mac`.
"""

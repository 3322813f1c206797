"""Pairs of serial telemetry modems with the firmware SiK: bytes in, bytes and RADIO_STATUS out, without I/O.

`links.SerialLinks` is the interface; `config` has the settings, `gains` the path gains. `timing`, `modem` and
`packets` follow the firmware, `serial_ports` has its buffers, `hopping` its channels, `errors` bit and packet
errors, `air` the transmissions of all pairs. The 802.11 channel is in `netsim.mac` and `netsim.emulator`.
"""

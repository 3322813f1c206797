"""Captures of the emulated channel for Wireshark.

`pcapng_writer` writes the file, `pcapng_blocks`, `radiotap` and `ieee80211` encode its parts. What is sent
and when is determined in `netsim.emulator`.
"""

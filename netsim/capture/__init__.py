"""Captures of the emulated channel for Wireshark: encoded frames, radiotap headers, pcapng files."""

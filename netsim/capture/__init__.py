"""The emulated channel as Wireshark sees it: frames as bytes, radiotap headers, pcapng files."""

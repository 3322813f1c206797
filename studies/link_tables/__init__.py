"""Bit-level simulation of one link, which makes the packet error tables `netsim.phy.vht_tables`.

The command line is ``scripts/link_tables.py``. The emulator is left to `netsim`.
"""

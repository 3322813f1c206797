"""The antenna alone: patterns, statistics and speed on the command line (``scripts/antenna_lab.py``)."""

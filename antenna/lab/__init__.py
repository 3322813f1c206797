"""Antenna patterns, statistics and benchmarks without a flight (``scripts/antenna_lab.py``)."""

"""Patterns of many snapshots at once, by the method of moments with few unknowns for each element."""

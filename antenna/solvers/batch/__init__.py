"""Batch solver: patterns of many snapshots by the method of moments with few unknowns per element."""

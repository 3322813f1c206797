"""Simulate VHT links bit by bit: ``python scripts/link_tables.py --out netsim/phy/vht_tables.csv``."""

import os

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from studies.link_tables.tables import tables_app

if __name__ == "__main__":
    tables_app()

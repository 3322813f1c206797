"""What the application sends and receives: beacons, the neighbour table, ranging policies.

Import `traffic`. The medium is left to `netsim`.
"""

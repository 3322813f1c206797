"""Radio traffic of the application: beacons, the neighbour table, ranging policies.

Import `traffic`. The medium is simulated by `netsim`.
"""

"""What long and many flights cost: growth of memory, descriptors and processor time, repeated hashes, sizes.

Import `cli`. Each section measures in worker processes (`studies.common.runner`) and judges their results.
"""

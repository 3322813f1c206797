"""Child processes: the protocol between a child and its parent, and processes that fork others.

Import `child_protocol` in a program that a launcher starts, `prefork` in one that forks its like.
Starting and supervising whole swarms is left to `harness.launch`.
"""

"""What flying costs: real-time factor, processor time by process and part, memory and start-up.

Measured against a floor that does nothing but what any lockstep simulation in Python must, in the same
minutes of the same machine. ``scripts/bench.py`` is its command line, docs/results/performance.md has the
results.
"""

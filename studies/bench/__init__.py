"""Benchmark of flights: real-time factor, processor time by process and part, memory and start-up time.

Flights alternate with a floor, a minimal lockstep simulation in Python, on the same machine. The command line
is ``scripts/bench.py``; the results are in docs/results/performance.md.
"""

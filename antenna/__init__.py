"""The swarm's synthetic-aperture antenna, a library of its own: it imports only `foundation`.

`model` describes arrays, `solvers` computes their patterns, `analysis` evaluates patterns, and `lab` is the
command line. What is flown, and when it is evaluated, is left to `harness.report.report`.
"""

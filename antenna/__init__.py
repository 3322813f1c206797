"""The swarm's synthetic-aperture antenna, an independent library that imports only `foundation`.

`model` describes arrays, `solvers` computes their patterns, `analysis` evaluates patterns, and `lab` is the
command line. The evaluation of flights is in `harness.report.report`.
"""

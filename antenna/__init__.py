"""The swarm's synthetic-aperture antenna, an independent library that imports only `foundation`.

`model` describes arrays, `solvers` computes their patterns, `analysis` evaluates patterns, and `lab` is the
command line. The antenna that a flight forms is evaluated in `harness.report`.
"""

"""The antenna alone, without a flight: patterns, statistics and benchmarks of drawn formations.

Import `formations` (ideal and disordered arrays), `hertzian` (closed-form elements) and `runs`; `cli` is the
command line (``scripts/antenna_lab.py``). Solvers are left to `antenna.solvers`, statistics to
`antenna.analysis`.
"""

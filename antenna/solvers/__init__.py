"""Solvers for far-field patterns of arrays: `batch` (own method of moments), `nec2` (PyNEC) and `nec2c`.

Import `selection.make_backend` and the protocol `interface.Backend`; `parallel` uses several processes.
Patterns are evaluated in `antenna.analysis`.
"""

"""Batch solver: patterns of many snapshots by the method of moments with few unknowns per element.

Import `solver.Batch`, and `accuracy` for what it can solve; `antenna.solvers.ports` also uses its kernels.
The choice of a solver is left to `antenna.solvers.selection`, clearances to `antenna.model`.
"""

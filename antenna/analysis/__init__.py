"""What is read from patterns: maxima, features, statistics over many of them, datasets and figures.

Import `patterns.Pattern` and functions on it. Nothing here depends on a solver.
"""

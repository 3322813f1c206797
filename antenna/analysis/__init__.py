"""Evaluation of patterns: maxima, features, statistics over many patterns, datasets and figures.

Import `patterns.Pattern` and the functions on it. This package does not depend on a solver.
"""

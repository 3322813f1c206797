"""Model of an array: settings, elements, positions, feeds, clearances, and NEC decks.

Import `config` for the settings and `geometry` for snapshots. Patterns are computed in `antenna.solvers`.
"""

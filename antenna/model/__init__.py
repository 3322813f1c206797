"""What an array is: settings, elements, positions, feeds, clearances, and NEC decks of it. No solver.

Import `config` for the settings and `geometry` for snapshots. Patterns are left to `antenna.solvers`.
"""

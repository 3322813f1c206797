"""Programs for ns-3 3.37 that make reference tables for the radio, and their runner.

Imports: studies.reference. The comparison with the emulator is in `studies.radio`.
"""

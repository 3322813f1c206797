"""Radio simulations without a flight: measurements with the emulator.

Import `cli` for the command line ``coflight radio``. Comparison with ns-3 is in `studies.radio`.
"""

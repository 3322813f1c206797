"""Radio simulations without a flight: one link at bit level, and measurements with the emulator."""

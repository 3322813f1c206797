"""Physical layer: modes and durations, propagation, interference, packet errors, clear channel assessment."""

"""Simulated sensors of the vehicles: noise, biases, rates and delays. No I/O."""

"""Rigid bodies, rotors and contacts: what really happens to the vehicles. No sensors, no wind."""

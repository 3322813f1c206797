"""Rigid bodies, rotors and contacts: what really happens to the vehicles. Wind and faults are given."""

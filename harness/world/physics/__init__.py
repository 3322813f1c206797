"""Rigid bodies, rotors and contacts: the true motion of the vehicles.

Import `world.World`; `interface.Physics` is what the simulation requires of it. Wind and faults are inputs.
"""

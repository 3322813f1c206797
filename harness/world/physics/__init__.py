"""Rigid bodies, rotors and contacts: the true motion of the vehicles. Wind and faults are inputs."""

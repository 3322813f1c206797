"""A policy that is searched in an environment of coflight: one UAV follows another by its beacons."""

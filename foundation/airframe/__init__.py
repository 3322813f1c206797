"""Airframes: what a multicopter is, for its physics and its autopilot alike.

`description` has the settings of an airframe file and what follows from them, `files` reads the files. Motion
is left to `harness.world.physics`, gains and allocation to `autopilot.control`.
"""

"""Formation flight: plan of places, phases, guidance, collision avoidance, height layers, wind estimate.

Import `formation_plan` for places over time, `guidance` for setpoints. `onboard.localisation` estimates the
positions of the swarm.
"""

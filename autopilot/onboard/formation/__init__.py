"""Formation flight: plan of places, phases, guidance, collision avoidance, height layers, wind estimate.

Import `formation_plan` for places over time, `guidance` for setpoints. Positions of the swarm come from
`onboard.localisation`.
"""

"""Physical layer: modes and durations, propagation, interference, packet errors, clear channel assessment.

`propagation` composes `path_loss`, `antenna`, `shadowing`, `fading` and `obstruction`; `medium` has the
frames on the air, `sensing` the busy medium, `survival` and `errors` what is received, `timing` slot and SIFS
by band and coverage class. Contention is in `netsim.mac`.
"""

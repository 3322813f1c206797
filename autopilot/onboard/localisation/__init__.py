"""Cooperative localisation: a Kalman filter over the formation from odometry, GPS and FTM distances.

Import `localisation.Localisation`. The radio schedule is left to `onboard.radio`, control to
`onboard.formation`.
"""

"""Cooperative localisation: a Kalman filter over the formation from odometry, GPS and FTM distances.

Import `localisation.CooperativeLocalisation`. `onboard.radio` has the radio schedule, `onboard.formation` the
control.
"""

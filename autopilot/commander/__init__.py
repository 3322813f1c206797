"""Arming, flight modes, failsafes, geofence, battery and land detection of one vehicle.

`commander` arms and changes modes, `arming_checks` has what each mode and arming need,
`failsafe` the table of causes and actions. Flying in a mode is left to `autopilot.navigation`.
"""

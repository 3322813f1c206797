"""Arming, flight modes, failsafes, geofence, battery and land detection of one vehicle.

`commander` has arming checks and mode changes, `arming_requirements` what each mode and arming need,
`failsafe` the table of causes and actions. Flying in a mode is left to `autopilot.navigation`.
"""

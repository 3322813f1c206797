"""Arming, flight modes, failsafes, geofence, battery and land detection of one vehicle."""

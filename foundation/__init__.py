"""Common base of all packages; it imports no other package of coflight.

Types shared by several packages are in `foundation.types`; each folder provides one technical service. Code
specific to the vehicle, the radio or the antenna is in `autopilot`, `netsim` and `antenna`.
"""

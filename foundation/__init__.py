"""What every package of coflight stands on; it imports no other package of coflight.

Types that several packages share are in `foundation.types`; each folder holds one technical service.
Anything that belongs to a vehicle, the radio or the antenna is left to `autopilot`, `netsim` and `antenna`.
"""

"""The application beside each autopilot: beacons, ranging, localisation, formation control. No I/O.

`OnboardApp` composes them. It speaks MAVLink to its autopilot and datagrams and ranging requests to its
radio, nothing else, so that it may as well ride on a companion computer beside a PX4.
"""

from autopilot.onboard.app import Estimate, OnboardApp, OnboardOutput

__all__ = ["Estimate", "OnboardApp", "OnboardOutput"]

"""The application beside each autopilot: beacons, ranging, localisation, formation control. No I/O.

`OnboardApp` composes them. It exchanges MAVLink messages with its autopilot, and datagrams and ranging
requests with its radio, nothing else. It can therefore also run on a companion computer beside a PX4.
"""

from autopilot.onboard.app import Estimate, OnboardApp, OnboardOutput

__all__ = ["Estimate", "OnboardApp", "OnboardOutput"]

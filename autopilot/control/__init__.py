"""Flight control in PX4's cascade: position, attitude, rates, allocation; and the moves they follow.

Pure: estimates, setpoints and time steps go in, motor controls come out.
"""

from autopilot.control.flight import FlightController
from autopilot.control.params import ControlParams
from autopilot.control.trajectory import PositionTrajectory

__all__ = ["ControlParams", "FlightController", "PositionTrajectory"]

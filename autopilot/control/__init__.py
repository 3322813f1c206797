"""Flight control in PX4's cascade (position, attitude, rates, allocation) and position trajectories.

Pure: estimates, setpoints and time steps are the inputs, motor controls the output.
"""

from autopilot.control.flight import FlightController
from autopilot.control.params import ControlParams
from autopilot.control.trajectory import PositionTrajectory

__all__ = ["ControlParams", "FlightController", "PositionTrajectory"]

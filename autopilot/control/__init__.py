"""Flight control in PX4's cascade: position, attitude, rates, allocation.

Pure: estimates, setpoints and time steps are the inputs, motor controls the output.
"""

from autopilot.control.flight import FlightController
from autopilot.control.params import ControlParams

__all__ = ["ControlParams", "FlightController"]

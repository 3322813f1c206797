"""ArduPilot's flight modes of copters: numbers in HEARTBEAT.custom_mode, names, and PX4's counterparts."""

from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode, mode_from_custom


class CopterMode(NamedTuple):
    """A mode of ArduCopter (ArduCopter/mode.h)."""

    label: str
    counterpart: FlightMode | None = None
    """The mode of PX4 with the same purpose; None: there is none."""


COPTER_MODES: Final = {
    0: CopterMode("Stabilize", FlightMode.STABILIZED),
    1: CopterMode("Acro", FlightMode.ACRO),
    2: CopterMode("AltHold", FlightMode.ALTITUDE),
    3: CopterMode("Auto", FlightMode.MISSION),
    4: CopterMode("Guided", FlightMode.OFFBOARD),
    5: CopterMode("Loiter", FlightMode.POSITION),
    6: CopterMode("RTL", FlightMode.RETURN),
    7: CopterMode("Circle", FlightMode.ORBIT),
    9: CopterMode("Land", FlightMode.LAND),
    11: CopterMode("Drift"),
    13: CopterMode("Sport"),
    14: CopterMode("Flip"),
    15: CopterMode("AutoTune"),
    16: CopterMode("PosHold", FlightMode.POSITION),
    17: CopterMode("Brake", FlightMode.HOLD),
    18: CopterMode("Throw"),
    19: CopterMode("AvoidADSB"),
    20: CopterMode("GuidedNoGPS"),
    21: CopterMode("SmartRTL", FlightMode.RETURN),
    22: CopterMode("FlowHold"),
    23: CopterMode("Follow"),
    24: CopterMode("ZigZag"),
    25: CopterMode("SystemID"),
    26: CopterMode("Autorotate"),
    27: CopterMode("AutoRTL", FlightMode.RETURN),
    28: CopterMode("Turtle"),
}
"""By number. All numbers are below PX4's, whose main mode is in the third byte."""
GUIDED: Final = 4


def counterpart(custom_mode: int) -> FlightMode | None:
    """Return the mode of PX4 that corresponds to a mode of ArduCopter; None: unknown or without one."""
    mode = COPTER_MODES.get(custom_mode)
    return None if mode is None else mode.counterpart


def label_of(heartbeat: common.MAVLink_heartbeat_message) -> str:
    """Return the name of the mode in an autopilot's HEARTBEAT; empty: unknown."""
    mode: CopterMode | FlightMode | None
    if heartbeat.autopilot == common.MAV_AUTOPILOT_ARDUPILOTMEGA:
        mode = COPTER_MODES.get(heartbeat.custom_mode)
    else:
        mode = mode_from_custom(heartbeat.custom_mode)
    return "" if mode is None else mode.label

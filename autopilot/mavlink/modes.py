"""PX4's flight modes: names, custom mode numbers and base modes in MAVLink."""

from enum import Enum

from pymavlink.dialects.v20 import common

_CUSTOM = common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_STABILIZE = common.MAV_MODE_FLAG_STABILIZE_ENABLED
_GUIDED = common.MAV_MODE_FLAG_GUIDED_ENABLED
_AUTO = common.MAV_MODE_FLAG_AUTO_ENABLED
_MANUAL = common.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED

_BASE_MODES = {
    1: _CUSTOM | _MANUAL,
    2: _CUSTOM | _MANUAL | _STABILIZE,
    3: _CUSTOM | _MANUAL | _STABILIZE | _GUIDED,
    4: _CUSTOM | _STABILIZE | _GUIDED | _AUTO,
    5: _CUSTOM | _MANUAL,
    6: _CUSTOM | _STABILIZE,
    7: _CUSTOM | _MANUAL | _STABILIZE,
}
"""By main mode, without the armed flag: 4 and 6 as observed from PX4 v1.17, the rest from its source."""


class FlightMode(Enum):
    """A flight mode: the name that QGroundControl shows, PX4's main mode and sub mode."""

    MANUAL = ("Manual", 1, 0)
    ALTITUDE = ("Altitude", 2, 0)
    POSITION = ("Position", 3, 0)
    ORBIT = ("Orbit", 3, 1)
    READY = ("Ready", 4, 1)
    TAKEOFF = ("Takeoff", 4, 2)
    HOLD = ("Hold", 4, 3)
    MISSION = ("Mission", 4, 4)
    RETURN = ("Return", 4, 5)
    LAND = ("Land", 4, 6)
    ACRO = ("Acro", 5, 0)
    OFFBOARD = ("Offboard", 6, 0)
    STABILIZED = ("Stabilized", 7, 0)
    DESCEND = ("Descend", 4, 6)
    """Landing without a position. It cannot be requested, and is reported as Land, as in PX4."""
    EXTERNAL1 = ("External 1", 4, 11)
    EXTERNAL2 = ("External 2", 4, 12)
    EXTERNAL3 = ("External 3", 4, 13)
    EXTERNAL4 = ("External 4", 4, 14)
    EXTERNAL5 = ("External 5", 4, 15)
    EXTERNAL6 = ("External 6", 4, 16)
    EXTERNAL7 = ("External 7", 4, 17)
    EXTERNAL8 = ("External 8", 4, 18)
    """Numbers for modes of the user: PX4's modes of other programs, from v1.15 on."""

    def __init__(self, label: str, main: int, sub: int) -> None:
        self.label = label
        self.main = main
        self.custom_mode = main << 16 | sub << 24
        self.base_mode = _BASE_MODES[main]

    __hash__ = object.__hash__  # members are singletons: Enum's hash of the name is slower


EXTERNAL_MODES = tuple(mode for mode in FlightMode if mode.name.startswith("EXTERNAL"))
_BY_CUSTOM_MODE = {mode.custom_mode: mode for mode in FlightMode if mode is not FlightMode.DESCEND}


def mode_from_custom(custom_mode: int) -> FlightMode | None:
    """Mode of HEARTBEAT's or SET_MODE's ``custom_mode``; None for a number that PX4 does not have."""
    return _BY_CUSTOM_MODE.get(custom_mode)


def mode_from_main_sub(main: float, sub: float) -> FlightMode | None:
    """Mode of MAV_CMD_DO_SET_MODE's second and third parameter; None for numbers that PX4 does not have."""
    if not (0.0 <= main < 256.0 and 0.0 <= sub < 256.0):  # also refuses NaN
        return None
    return _BY_CUSTOM_MODE.get(int(main) << 16 | int(sub) << 24)

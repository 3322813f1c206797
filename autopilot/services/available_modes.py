"""AVAILABLE_MODES and CURRENT_MODE: the flight modes, as ground stations list them."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import MODE_NEEDS
from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import AvailableModes
from autopilot.mavlink.modes import FlightMode

AVAILABLE_MODES_ID: int = AvailableModes.id

STANDARD_MODES: dict[FlightMode, int] = {
    FlightMode.POSITION: common.MAV_STANDARD_MODE_POSITION_HOLD,
    FlightMode.ALTITUDE: common.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    FlightMode.RETURN: common.MAV_STANDARD_MODE_SAFE_RECOVERY,
    FlightMode.MISSION: common.MAV_STANDARD_MODE_MISSION,
    FlightMode.LAND: common.MAV_STANDARD_MODE_LAND,
    FlightMode.TAKEOFF: common.MAV_STANDARD_MODE_TAKEOFF,
    FlightMode.ORBIT: common.MAV_STANDARD_MODE_ORBIT,
}
"""MAV_STANDARD_MODE, as in PX4; the other modes are not standard (0) and are sent by name."""

_ADVANCED, _NOT_SELECTABLE, _AUTO = 1, 2, 4
"""MAV_MODE_PROPERTY bits."""
_ADVANCED_MODES = frozenset({FlightMode.STABILIZED, FlightMode.OFFBOARD})
_MAIN_AUTO = 4


def available_modes(index: int) -> Sequence[Message]:
    """Return the mode of a 1-based index, all modes for 0, or none for an index out of range."""
    if index == 0:
        return [_describe(number) for number in range(1, len(_MODES) + 1)]
    return [_describe(index)] if 1 <= index <= len(_MODES) else []


_MODES = tuple(mode for mode in FlightMode if mode in MODE_NEEDS and mode is not FlightMode.DESCEND)
"""In the order of their indices; Descend cannot be selected."""


def _describe(number: int) -> Message:
    mode = _MODES[number - 1]
    standard = STANDARD_MODES.get(mode, 0)
    properties = _ADVANCED if mode in _ADVANCED_MODES else 0
    if mode.main == _MAIN_AUTO:
        properties |= _AUTO
    if mode is FlightMode.ORBIT:
        properties |= _NOT_SELECTABLE  # needs a centre, from MAV_CMD_DO_ORBIT
    return AvailableModes(
        number_modes=len(_MODES), mode_index=number, standard_mode=standard, custom_mode=mode.custom_mode,
        properties=properties, mode_name="" if standard else mode.label,
    )  # fmt: skip

"""How the application commands the autopilot beside it: PX4, which coflight's own resembles, or ArduPilot.

Both take positions, velocities and accelerations by SET_POSITION_TARGET_LOCAL_NED, PX4 in offboard mode,
ArduPilot in guided mode.
"""

from collections.abc import Callable
from typing import Final

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink import ardupilot_modes
from autopilot.mavlink.modes import FlightMode, mode_from_custom
from autopilot.onboard.client.commands import RepeatedCommand

_CUSTOM = float(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_NAN = float("nan")


class AutopilotInterface(Struct, frozen=True, kw_only=True):
    """Commands and conventions of one kind of autopilot."""

    follow: RepeatedCommand
    """Changes to the mode in which it follows setpoints, which `mode` returns as `FlightMode.OFFBOARD`."""
    take_off: Callable[[float, float], RepeatedCommand]
    """(height above the ground, altitude of the ground above mean sea level) in m: takes off and hovers."""
    mode: Callable[[int], FlightMode | None]
    """(HEARTBEAT.custom_mode): the mode of PX4 with the same purpose; None: unknown or without one."""
    gain_names: tuple[str, ...]
    """Names of its parameter of the position loop's gain, 1/s, of which a version has one."""
    barometer_message: str
    """Message with the barometer's altitude or pressure."""
    integers_are_bytes: bool
    """Whether the protocol of parameters has the bytes of an integer in its float, instead of its value."""
    follows_before_take_off: bool
    """Whether that mode is its mode for arming and take-off, which a setpoint would end. Otherwise it needs
    setpoints before it changes to that mode."""
    mixes_axes: bool
    """Whether the axes of one vector may be given or ignored separately."""


def _take_off_px4(height_m: float, ground_alt_m: float) -> RepeatedCommand:
    altitude_m = ground_alt_m + height_m
    return RepeatedCommand(common.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, _NAN, _NAN, _NAN, altitude_m))


def _take_off_ardupilot(height_m: float, ground_alt_m: float) -> RepeatedCommand:  # noqa: ARG001
    return RepeatedCommand(common.MAV_CMD_NAV_TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m))


PX4: Final = AutopilotInterface(
    follow=RepeatedCommand(
        common.MAV_CMD_DO_SET_MODE, (_CUSTOM, FlightMode.OFFBOARD.main, 0.0, 0.0, 0.0, 0.0, 0.0)
    ),
    take_off=_take_off_px4,
    mode=mode_from_custom,
    gain_names=("MPC_XY_P",),
    barometer_message="ALTITUDE",
    integers_are_bytes=True,
    follows_before_take_off=False,
    mixes_axes=True,
)
ARDUPILOT: Final = AutopilotInterface(
    follow=RepeatedCommand(
        common.MAV_CMD_DO_SET_MODE, (_CUSTOM, ardupilot_modes.GUIDED, 0.0, 0.0, 0.0, 0.0, 0.0)
    ),
    take_off=_take_off_ardupilot,
    mode=ardupilot_modes.counterpart,
    gain_names=("PSC_NE_POS_P", "PSC_POSXY_P"),  # from 4.7 on, and before
    barometer_message="SCALED_PRESSURE",
    integers_are_bytes=False,
    follows_before_take_off=True,
    mixes_axes=False,
)

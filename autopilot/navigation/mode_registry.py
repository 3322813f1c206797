"""The flight modes: one row for each, with its number and the class of its behaviour.

The class states its properties for commander and ground stations in `ModeTraits`. A built-in mode is one
class and one row of `MODES`; a mode of the user is one class, for which `user_row` makes the row.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from autopilot.commander.arming_checks import Condition
from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTable, ModeTraits
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode
from autopilot.navigation.flight_mode import FlightModeBehaviour, ModeContext, StopMode
from autopilot.navigation.hold import HoldMode
from autopilot.navigation.landing import DescendMode, LandMode, TakeOffMode
from autopilot.navigation.manual import AltitudeMode, PositionMode, StabilizedMode
from autopilot.navigation.mission_flight import MissionMode
from autopilot.navigation.orbit import OrbitMode
from autopilot.navigation.return_home import ReturnMode
from autopilot.navigation.user_mode import UserMode


class OffboardMode(StopMode):
    """Offboard: its setpoints are external and do not pass through navigation."""

    traits = ModeTraits(needs=FLIES_TO_A_PLACE | Condition.SETPOINTS, arms=True, is_advanced=True)


class ModeRow(NamedTuple):
    """One flight mode."""

    mode: FlightMode
    traits: ModeTraits
    make: Callable[..., FlightModeBehaviour]
    """Creates the behaviour from a `ModeContext` and the behaviours of ``parts``."""
    parts: tuple[FlightMode, ...] = ()
    """Modes of earlier rows; their behaviours are parts of this one."""


def _row(mode: FlightMode, kind: type[StopMode], *parts: FlightMode) -> ModeRow:
    return ModeRow(mode, kind.traits, kind, parts)


MODES: tuple[ModeRow, ...] = (
    _row(FlightMode.TAKEOFF, TakeOffMode),
    _row(FlightMode.LAND, LandMode),
    _row(FlightMode.HOLD, HoldMode, FlightMode.LAND),
    _row(FlightMode.MISSION, MissionMode, FlightMode.TAKEOFF, FlightMode.LAND),
    _row(FlightMode.RETURN, ReturnMode, FlightMode.LAND),
    _row(FlightMode.ORBIT, OrbitMode),
    _row(FlightMode.OFFBOARD, OffboardMode),
    _row(FlightMode.POSITION, PositionMode),
    _row(FlightMode.ALTITUDE, AltitudeMode),
    _row(FlightMode.STABILIZED, StabilizedMode),
    _row(FlightMode.DESCEND, DescendMode),
)


def user_row(
    number: int, traits: ModeTraits, make: Callable[[ModeContext], FlightModeBehaviour], title: str
) -> ModeRow:
    """Return the row of the user's mode of a number from 0 to 7; ``title`` begins its lines of failure."""
    return ModeRow(EXTERNAL_MODES[number], traits, lambda context: UserMode(make(context), title))


def mode_table(rows: Iterable[ModeRow] = MODES) -> ModeTable:
    """Return the properties of these modes for the commander."""
    return ModeTable({row.mode: row.traits for row in rows})

"""Properties of flight modes for the commander: their needs, and how they begin and end.

Each mode's class states its `ModeTraits` (`autopilot.navigation.mode_registry`); a `ModeTable` has those of
all modes of one vehicle.
"""

from collections.abc import Mapping

from msgspec import Struct

from autopilot.commander.arming_checks import ARMING_NEEDS, Condition, Reason, all_missing
from autopilot.mavlink.modes import FlightMode

FLIES_TO_A_PLACE = Condition.ATTITUDE | Condition.HEIGHT | Condition.VELOCITY | Condition.POSITION

NAME_MOST = 34
"""Characters of a name in AVAILABLE_MODES."""


class ModeTraits(Struct, frozen=True, kw_only=True):
    """Properties of a flight mode."""

    needs: Condition
    """Conditions without which it cannot be entered in flight, and which end it: a failsafe follows."""
    arms: bool = False
    """Whether the vehicle may be armed in it."""
    by_sticks: bool = False
    """Whether a pilot flies it by sticks: moving them does not end it, and without them it becomes Hold."""
    of_one_flight: bool = False
    """Whether Hold replaces it after disarming, so that a flight does not begin in the mode in which another
    ended."""
    name: str = ""
    """Name in ground stations, at most `NAME_MOST` characters; empty: that of its number."""
    standard: int = 0
    """MAV_STANDARD_MODE; 0: none, so ground stations show its name."""
    is_advanced: bool = False
    """Shown by ground stations among the advanced modes."""
    is_selectable: bool = True
    """Whether ground stations offer it in their list of modes."""

    def __post_init__(self) -> None:
        """Check that AVAILABLE_MODES can carry the name."""
        if len(self.name) > NAME_MOST or not self.name.isascii():
            raise ValueError(f"name: {self.name!r}; expected at most {NAME_MOST} ASCII characters")


class ModeTable:
    """The modes of one vehicle. Needs are plain integers, because flag types take ten times as long."""

    def __init__(self, traits: Mapping[FlightMode, ModeTraits]) -> None:
        self.traits = dict(traits)
        """By mode, of all modes that are implemented."""
        self.needs = {mode: int(each.needs) for mode, each in traits.items()}
        """`Condition` bits."""
        self.by_sticks = frozenset(mode for mode, each in traits.items() if each.by_sticks)
        self.of_one_flight = frozenset(mode for mode, each in traits.items() if each.of_one_flight)
        self.automatic = frozenset(traits) - self.by_sticks - {FlightMode.MISSION, FlightMode.OFFBOARD}
        """The modes of bit 1 of COM_RCL_EXCEPT and COM_DLL_EXCEPT."""
        self.offered = tuple(mode for mode in FlightMode if mode in traits and mode is not FlightMode.DESCEND)
        """Modes that stations may request, in the order of AVAILABLE_MODES; Descend is for failsafes only."""

    def name(self, mode: FlightMode) -> str:
        """Return the mode's name in ground stations."""
        return self.traits[mode].name or mode.label if mode in self.traits else mode.label

    def standard(self, mode: FlightMode) -> int:
        """Return its MAV_STANDARD_MODE; 0: none."""
        return self.traits[mode].standard if mode in self.traits else 0

    def arming_needs(self, mode: FlightMode) -> int:
        """Return the `Condition` bits that arming in this mode requires."""
        needs = int(ARMING_NEEDS) | self.needs[mode]
        return needs | int(Condition.GPS) if needs & Condition.POSITION else needs

    def arming_refusals(self, mode: FlightMode, conditions: int, *, armable: bool) -> list[Reason]:
        """Return the reasons for which arming in this mode is refused, the most basic first.

        ``conditions`` are the `Condition` bits that are met, ``armable`` is COM_ARMABLE. The causes of
        failsafes that prevent arming as well are checked by `Commander.arming_refusals`.
        """
        reasons = [] if armable else [Reason.NOT_ARMABLE]
        if mode not in self.traits or not self.traits[mode].arms:
            reasons.append(Reason.MODE_CANNOT_ARM)
        if mode in self.traits:
            reasons += all_missing(self.arming_needs(mode), conditions)
        return reasons

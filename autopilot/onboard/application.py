"""The public interface of an on-board application: what it receives, what it reports. No I/O.

An application controls one UAV through its autopilot (MAVLink) and its radio (datagrams, ranging), nothing
else. The scenario names its class: ``onboard.application = "package.module:Class"``. The class is created
as ``Class()``; with a class attribute ``Settings``, a msgspec Struct or dataclass, as ``Class(settings)``
with the table ``[onboard.settings]``. The built-in application is `autopilot.onboard.app.OnboardApp`.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

from msgspec import Struct

from autopilot.mavlink.codec import Message
from autopilot.navigation.site_frame import UNKNOWN_NED_M
from foundation.types import Vector
from netsim.wire.messages import RxItem

if TYPE_CHECKING:
    from autopilot.onboard.context import Context

HIGHEST_PHASE = 254
"""255 means in logs that a vehicle has no application."""
MOST_VALUES = 58
"""Numbers of a status: those of a DEBUG_FLOAT_ARRAY."""
MOST_TEXT = 50
"""Characters of a status: those of a STATUSTEXT."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")


class RunningPhase(IntEnum):
    """The only phase of an application that declares none."""

    RUNNING = 0


class Reports(Struct, frozen=True, kw_only=True):
    """What `Application.status` reports: declared by the class, so that logs and displays have names."""

    phases: type[IntEnum] = RunningPhase
    """Phases of a flight; values 0..254. Displays show the names in lower case, ``_`` as a space."""
    formed: tuple[IntEnum, ...] = ()
    """Phases in which the application has reached its aim. A run counts as formed when all applications have,
    without those in ``absent``; it never does if this is empty."""
    absent: tuple[IntEnum, ...] = ()
    """Phases in which it takes no part, such as after landing."""
    placed: tuple[IntEnum, ...] = ()
    """Phases in which it flies to its place of the scenario's formation, or is there: displays then show its
    distance from it."""
    values: tuple[str, ...] = ()
    """Names of the numbers of a status, at most 58: lower case, with their units, such as ``spread_m``. They
    are columns ``app_spread_m`` of ``flight.parquet``."""

    def __post_init__(self) -> None:
        """Check numbers and names; raises ValueError."""
        if not all(0 <= phase <= HIGHEST_PHASE for phase in self.phases):
            raise ValueError(f"phases: {self.phases.__name__} has a value out of 0..{HIGHEST_PHASE}")
        for field in ("formed", "absent", "placed"):
            members: tuple[IntEnum, ...] = getattr(self, field)
            for each in members:
                if each not in self.phases:
                    raise ValueError(f"{field}: {each!r} is no member of {self.phases.__name__}")
        if len(self.values) > MOST_VALUES:
            raise ValueError(f"values: {len(self.values)} names; expected at most {MOST_VALUES}")
        for name in self.values:
            if not _NAME.fullmatch(name):
                raise ValueError(f"values: {name!r}; expected lower-case letters, digits and _, at most 31")
        if len(set(self.values)) < len(self.values):
            raise ValueError("values: a name occurs twice")

    def layout(self) -> "Layout":
        """Return the same as numbers and texts."""
        return Layout(
            phases={int(phase): phase.name.lower().replace("_", " ") for phase in self.phases},
            formed=frozenset(map(int, self.formed)),
            absent=frozenset(map(int, self.absent)),
            placed=frozenset(map(int, self.placed)),
            values=self.values,
        )


class Layout(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`Reports` of a swarm's applications as numbers and texts, for processes without their classes.

    Fields as in `Reports`; phases by their numbers.
    """

    phases: dict[int, str] = {}
    """Names in lower case."""
    formed: frozenset[int] = frozenset()
    absent: frozenset[int] = frozenset()
    placed: frozenset[int] = frozenset()
    values: tuple[str, ...] = ()
    """Those of the application, and those of other programs as ``PROGRAM_NAME``."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numbers in tables."""
        return tuple(f"app_{name}" for name in self.values)


NO_APPLICATION = Layout()


class Status(Struct, frozen=True):
    """Present status of an application."""

    phase: IntEnum = RunningPhase.RUNNING
    """A member of `Reports.phases`: sent as custom mode of the application's HEARTBEAT, and logged."""
    text: str = ""
    """At most 50 ASCII characters; sent to ground stations as STATUSTEXT (information), shown and recorded
    among the run's events whenever it changes. Empty: nothing."""
    values: Mapping[str, float] = {}
    """Numbers by the names of `Reports.values`; those that are missing are NaN. They are logged with each row
    of ``flight.parquet``, sent as DEBUG_FLOAT_ARRAY, and part of a swarm's truth."""
    motion_start_us: int | None = None
    """Simulated time at which the motion of the scenario's formation begins, as agreed by the UAVs. Errors in
    displays and reports are distances from the moving places after it."""


class Estimate(NamedTuple):
    """An application's estimate of its UAV's position; site NED, metres. NaN: unknown."""

    pos_ned_m: Vector = UNKNOWN_NED_M
    """The autopilot's position minus the correction."""
    std_ned_m: Vector = UNKNOWN_NED_M
    """One sigma, including the position error of the formation as a whole."""
    correction_ned_m: Vector = UNKNOWN_NED_M
    odometry_offset_ned_m: Vector = UNKNOWN_NED_M
    """Part of the correction that depends on the radio: estimated true position minus odometry. NaN until
    localisation has estimated it; frozen while no distances arrive."""


NO_ESTIMATE = Estimate()


class Application(Protocol):
    """The application of one UAV; subclasses override what they need.

    Call order: `start` once. Then in each step of the vehicle any number of `on_mavlink`, `on_radio` and
    `on_request`; then, if the loop (``onboard.loop_period_ms``) is due, `on_timer` and `status`, once each.
    `estimate` is called for rows of the log. What is sent with the context's radio and autopilot leaves after
    `on_timer`.

    Simulated time ``now_us`` is shared by all UAVs and does not decrease. There is no other clock, no I/O and
    no global randomness: random values are drawn from the context's generator, so equal inputs give equal
    outputs, in a process of its own and in one process.

    An exception ends the vehicle, or beside a PX4 or ArduPilot the application: its traceback is in the
    vehicle's log.
    """

    reports: ClassVar[Reports] = Reports()
    """Names of what `status` reports."""

    def start(self, context: "Context") -> None:
        """Store the context; called once before everything else."""

    def on_mavlink(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot: telemetry, HEARTBEAT, COMMAND_ACK, PARAM_VALUE.

        The context's autopilot has processed it before. Frequent messages are plain values with the same
        fields (`autopilot.mavlink.local_messages`). After `Context.request_truth` HIL_STATE_QUATERNION
        follows.
        """

    def on_request(self, message: Message) -> Sequence[Message]:  # noqa: ARG002  for subclasses
        """Return the answers to a message that a station on a link addressed to the application."""
        return ()

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:
        """Process what the radio received and measured, in order of (time, source, sequence number).

        `Delivery`: a datagram. `FtmResult`: the end of a ranging session of `range_to`. `Sent`: the outcome
        of a `unicast`. `Survey`: the time for which the channel was busy.
        """

    def on_timer(self, now_us: int) -> None:
        """Run one iteration of the loop."""

    def status(self) -> Status:
        """Return the present status."""
        return Status()

    def estimate(self, now_us: int) -> Estimate:  # noqa: ARG002  for subclasses
        """Return the position estimate at ``now_us``, which may be after the last iteration."""
        return NO_ESTIMATE

    def troubles(self) -> Mapping[str, int]:
        """Return counts of the faults that occurred so far and were handled, by name."""
        return {}

    @classmethod
    def warm_up(cls) -> None:
        """Call compiled functions once, with discarded results, so that none is compiled in flight.

        Called before the first object is created, in each process that has the application.
        """

    @classmethod
    def dissectors(cls, port: int) -> Mapping[str, str]:  # noqa: ARG003  for subclasses
        """Return Wireshark's dissectors (Lua) of its datagrams to a UDP port, by the names of their files.

        They are written to a run's folder next to the capture of its channel (``radio.capture``).
        """
        return {}

"""The interface of an on-board application, and what it returns.

Consumers: `autopilot.vehicle` in the vehicle's process, `autopilot.process.companion` beside a PX4. The
built-in application is `autopilot.onboard.app.OnboardApp`; `autopilot.onboard.factory` creates it.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol

from msgspec import Struct

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import PositionTarget
from foundation.types import Vector
from netsim.wire.messages import RxItem, TxItem


class OnboardOutput(Struct, frozen=True):
    """What an application sends in one iteration of its loop."""

    mavlink: Sequence[Message | PositionTarget]
    """Messages to the autopilot of the same UAV; `PositionTarget` is the setpoint of offboard mode."""
    radio: tuple[TxItem, ...]
    """Datagrams and ranging requests, with send times from now until the next iteration."""


NOTHING = OnboardOutput((), ())
"""Output of an iteration in which nothing is due."""


class Estimate(NamedTuple):
    """An application's estimate of its UAV's position; site NED, metres. NaN: unknown."""

    pos_ned_m: Vector
    """The autopilot's position minus the correction."""
    std_ned_m: Vector
    """One sigma, including the position error of the formation as a whole."""
    correction_ned_m: Vector
    odometry_offset_ned_m: Vector
    """Part of the correction that depends on the radio: estimated true position minus odometry. NaN until
    localisation has estimated it; frozen while no distances arrive."""


class Application(Protocol):
    """The application of one UAV: messages, radio items and time in, messages and radio items out.

    Call order: in each step of the vehicle any number of `on_mavlink`, `on_radio` and `on_request`; then, if
    the application's loop (``onboard.loop_period_ms``) is due, once `on_timer`. `estimate` and `phase` are
    read after the step, for the log.

    ``now_us`` is simulated time, which all UAVs share and which does not decrease. There is no other clock,
    no I/O and no global randomness: random values are drawn from a generator that the factory seeds with the
    run's seed and the UAV's number, so equal inputs give equal outputs.
    """

    def on_mavlink(self, msg: Message, now_us: int) -> None:
        """Process a message of the autopilot: telemetry (streams), HEARTBEAT, COMMAND_ACK, PARAM_VALUE.

        LOCAL_POSITION_NED may be a `LocalPosition` (`autopilot.mavlink.local_messages`) with the same fields.
        With ``onboard.localisation = "truth"`` HIL_STATE_QUATERNION follows. Unused types are ignored.
        """

    def on_request(self, msg: Message) -> Sequence[Message]:
        """Return the answers to a message that a station on a link addressed to the application."""

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:
        """Process what the radio received and measured, in order of (time, source, sequence number)."""

    def on_timer(self, now_us: int) -> OnboardOutput:
        """Return everything to send in this iteration of the loop; `NOTHING` if nothing is due."""

    def estimate(self, now_us: int) -> Estimate:
        """Return the position estimate at ``now_us``, which may be after the last iteration."""

    @property
    def phase(self) -> int:
        """Phase of the flight for the log, 0..254; see `autopilot.onboard.formation.phases.FlightPhase`."""

    def troubles(self) -> Mapping[str, int]:
        """Return counts of the faults that occurred so far and were handled, by name."""

"""What the launcher says to the physics server, and what that says back.

JSON lines over its stdin and stdout.

The physics server does nothing by itself: it simulates while a `RunUntil` lasts and waits otherwise, so
whoever drives it can look at the truth, kill a vehicle or cut the channel at an exact simulated time, and
get the same run again.
"""

from typing import Literal

from msgspec import Struct

from foundation.processes.child_protocol import Stop
from harness.world.faults import AnyFault

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class SimulatorCommand(Struct, frozen=True, kw_only=True, tag_field="command", tag=str.lower):
    """From the launcher."""


class RunUntil(SimulatorCommand, frozen=True, kw_only=True):
    """Simulate up to ``time_us``, or until the formation is reached if asked; answered by `Paused`."""

    time_us: int
    stop_when_formed: bool = False
    speed: float = 0.0
    """Against wall time; 0 runs as fast as it can."""


class Pause(SimulatorCommand, frozen=True, kw_only=True):
    """Let simulated time stand until `Resume`; a `RunUntil` that lasts, or comes, goes on then."""


class Resume(SimulatorCommand, frozen=True, kw_only=True):
    """Let simulated time go on; nothing if it does."""


class SetSpeed(SimulatorCommand, frozen=True, kw_only=True):
    """Another ``speed`` for the `RunUntil` that lasts."""

    speed: float


class SetAttenuation(SimulatorCommand, frozen=True, kw_only=True):
    """From the air's next interval on, attenuate every radio link by this; None: as the scenario says."""

    extra_attenuation_db: float | None


class SetPid(SimulatorCommand, frozen=True, kw_only=True):
    """Process id of a vehicle, so that a starved vehicle can be told from a stopped one."""

    instance: int
    pid: int


class InjectFault(SimulatorCommand, frozen=True, kw_only=True):
    """From the next step on, or the fault's ``start_s`` later, have it in force."""

    fault: AnyFault


AnyCommand = RunUntil | Pause | Resume | SetSpeed | SetAttenuation | SetPid | InjectFault | Stop


class SimulatorEvent(Struct, frozen=True, kw_only=True, tag_field="event", tag=str.lower):
    """From the physics server, besides the child's common `Ready` and `Finished`."""

    time_us: int


class VehicleTruth(Struct, frozen=True, kw_only=True):
    """One vehicle as it really is."""

    alive: bool
    armed: bool
    mode: str
    phase: str
    """Of the on-board application: see autopilot.onboard."""
    pos_ned_m: Vector
    vel_ned_m_s: Vector
    q_ned_frd: Quaternion
    error_m: float
    """Horizontal distance from its place in the formation, wherever that moves."""


class Progress(SimulatorEvent, frozen=True, kw_only=True):
    """A few times per second of wall time while running."""

    wall_s: float
    channel_busy_fraction: float
    vehicles: tuple[VehicleTruth, ...]
    lag_s: float = 0.0
    """Wall time by which the run has fallen behind the speed asked for, in all: it is not caught up with."""
    paused: bool = False
    """Simulated time stands, for that was asked for."""
    wall_paused_s: float = 0.0
    """Wall time for which the present `RunUntil` has stood on request so far."""


class Paused(SimulatorEvent, frozen=True, kw_only=True):
    """`RunUntil` is done, or cannot go on (``reason``)."""

    reason: str
    """``time``.

    ``formed``, ``no_vehicles``, ``vehicle_lost`` (where the scenario ends runs for it) or ``command``.
    """
    vehicles: tuple[VehicleTruth, ...]
    wall_paused_s: float = 0.0
    """Wall time for which the run stood on request."""


class Formed(SimulatorEvent, frozen=True, kw_only=True):
    """Every application says that it is on station, for the first time; who has left does not count."""


class FormationMoves(SimulatorEvent, frozen=True, kw_only=True):
    """More than half of the living vehicles' applications say the same start of the formation's motion.

    Once they do, and again when that start is another one.
    """

    start_us: int


class VehicleLost(SimulatorEvent, frozen=True, kw_only=True):
    """A vehicle's rotors stop from here on."""

    instance: int
    reason: str


class VehicleSilent(SimulatorEvent, frozen=True, kw_only=True):
    """A vehicle has not answered for a while of wall time; it is still waited for."""

    instance: int
    wall_silence_s: float


class Collision(SimulatorEvent, frozen=True, kw_only=True):
    """Two vehicles touched; ``time_us`` is that of the first step in contact."""

    first: int
    second: int
    pos_ned_m: Vector


class FaultChanged(SimulatorEvent, frozen=True, kw_only=True):
    """A fault comes into force or has been; ``time_us`` is that of the first step with or without it."""

    number: int
    """Among the scenario's faults, from 0 on; those that are injected count on from there."""
    instance: int | None
    """None: every vehicle."""
    what: str
    """Its kind, as in a scenario."""
    motor: int | None
    """None: of no motor."""
    change: Literal["began", "ended"]


AnyEvent = (
    Progress | Paused | Formed | FormationMoves | VehicleLost | VehicleSilent | Collision | FaultChanged
)

"""Commands of the launcher to the physics server, and its events: JSON lines over its stdin and stdout.

The physics server simulates only during a `RunUntil` and waits otherwise. The launcher can therefore read the
truth, kill a vehicle or cut the channel at an exact simulated time, and repeat the run exactly.
"""

from typing import Literal

from msgspec import Struct

from foundation.processes.child_protocol import Stop
from foundation.types import Vector
from harness.world.faults import AnyFault

Quaternion = tuple[float, float, float, float]


class SimulatorCommand(Struct, frozen=True, kw_only=True, tag_field="command", tag=str.lower):
    """From the launcher."""


class RunUntil(SimulatorCommand, frozen=True, kw_only=True):
    """Simulate up to ``time_us``, or until the formation is reached (``stop_when_formed``); see `Paused`."""

    time_us: int
    stop_when_formed: bool = False
    speed: float = 0.0
    """Simulated over wall time; 0: as fast as possible."""


class Pause(SimulatorCommand, frozen=True, kw_only=True):
    """Stop simulated time until `Resume`; the present or next `RunUntil` continues then."""


class Resume(SimulatorCommand, frozen=True, kw_only=True):
    """Continue after `Pause`; no effect otherwise."""


class SetSpeed(SimulatorCommand, frozen=True, kw_only=True):
    """Change the ``speed`` of the present `RunUntil`."""

    speed: float


class SetAttenuation(SimulatorCommand, frozen=True, kw_only=True):
    """Set the attenuation of every radio link from the next interval on, before radio faults."""

    extra_attenuation_db: float


class SetPid(SimulatorCommand, frozen=True, kw_only=True):
    """Process id of a vehicle, to distinguish a starved vehicle from a stopped one."""

    instance: int
    pid: int
    is_application: bool = False
    """The process is that of the application beside the vehicle's PX4."""


class SetRadioPid(SimulatorCommand, frozen=True, kw_only=True):
    """Process id of the 802.11 emulator, as `SetPid`."""

    pid: int


class InjectFault(SimulatorCommand, frozen=True, kw_only=True):
    """Activate a fault from the next step on, or its ``start_s`` later."""

    fault: AnyFault


AnyCommand = RunUntil | Pause | Resume | SetSpeed | SetAttenuation | SetPid | SetRadioPid | InjectFault | Stop


class SimulatorEvent(Struct, frozen=True, kw_only=True, tag_field="event", tag=str.lower):
    """From the physics server, in addition to every child's `Ready` and `Finished`."""

    time_us: int


class VehicleTruth(Struct, frozen=True, kw_only=True):
    """True state of one vehicle."""

    alive: bool
    armed: bool
    mode: str
    phase: str
    """Phase of the on-board application, see `coflight.Reports`; empty without one."""
    pos_ned_m: Vector
    vel_ned_m_s: Vector
    q_ned_frd: Quaternion
    error_m: float
    """Horizontal distance from its (moving) place in the formation."""
    aim: Literal["unknown", "ahead", "reached", "dropped"] = "unknown"
    """Whether the application has reached its aim, by its phase: ``dropped`` in its absent phases."""
    is_placed: bool = False
    """Whether its application flies to its place in the formation, or is there."""
    text: str = ""
    """Text of the application's status."""
    values: dict[str, float] = {}
    """Numbers of the application's status, without those that are unknown or not finite."""


class Progress(SimulatorEvent, frozen=True, kw_only=True):
    """State of the run, sent a few times per second of wall time."""

    wall_s: float
    channel_busy_fraction: float
    vehicles: tuple[VehicleTruth, ...]
    lag_s: float = 0.0
    """Total wall time by which the run has fallen behind the requested speed; it is not caught up."""
    paused: bool = False
    """Simulated time is stopped by `Pause`."""
    wall_paused_s: float = 0.0
    """Wall time for which the present `RunUntil` has been paused so far."""


class Waiting(SimulatorEvent, frozen=True, kw_only=True):
    """A step waits for an answer of another process; repeated a few times per second of wall time."""


class Paused(SimulatorEvent, frozen=True, kw_only=True):
    """`RunUntil` has ended, for a ``reason``."""

    reason: str
    """``time``, ``formed``, ``no_vehicles``, ``command``, or ``vehicle_lost`` if the scenario ends runs
    then."""
    vehicles: tuple[VehicleTruth, ...]
    wall_paused_s: float = 0.0
    """Wall time for which the run was paused."""


class Formed(SimulatorEvent, frozen=True, kw_only=True):
    """Every application has reached its aim, for the first time; those in absent phases do not count."""


class ApplicationText(SimulatorEvent, frozen=True, kw_only=True):
    """The status of an on-board application has a new text."""

    instance: int
    text: str


class FormationMoves(SimulatorEvent, frozen=True, kw_only=True):
    """More than half of the living vehicles' applications report the same start of the formation's motion.

    Sent for the first such start and for every change.
    """

    start_us: int


class VehicleLost(SimulatorEvent, frozen=True, kw_only=True):
    """A vehicle was removed from the run; its rotors stop."""

    instance: int
    reason: str


class ApplicationLost(SimulatorEvent, frozen=True, kw_only=True):
    """The application beside a PX4 ended or hangs; the PX4 flies on without it."""

    instance: int
    reason: str


class ApplicationSilent(SimulatorEvent, frozen=True, kw_only=True):
    """The application beside a PX4 has not answered for ``wall_silence_s``; it is waited for."""

    instance: int
    wall_silence_s: float


class VehicleSilent(SimulatorEvent, frozen=True, kw_only=True):
    """A vehicle has not answered for ``wall_silence_s``; the simulator continues to wait."""

    instance: int
    wall_silence_s: float


class Collision(SimulatorEvent, frozen=True, kw_only=True):
    """Two vehicles touched; ``time_us`` is that of the first step in contact."""

    first: int
    second: int
    pos_ned_m: Vector


class FaultChanged(SimulatorEvent, frozen=True, kw_only=True):
    """A fault begins or ends; ``time_us`` is that of the first step with or without it."""

    number: int
    """Index among the scenario's faults, from 0; injected faults continue the numbering."""
    instance: int | None
    """None: every vehicle."""
    what: str
    """The fault's ``kind``, as in a scenario."""
    motor: int | None
    """None: no motor is affected."""
    change: Literal["began", "ended"]


AnyEvent = (
    Progress
    | Waiting
    | Paused
    | Formed
    | FormationMoves
    | ApplicationText
    | VehicleLost
    | ApplicationLost
    | ApplicationSilent
    | VehicleSilent
    | Collision
    | FaultChanged
)

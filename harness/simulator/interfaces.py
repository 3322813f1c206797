"""What the simulation asks of its vehicles and of the air, however these are reached."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

from harness.simulator.actuator_inbox import ActuatorInbox
from harness.world.physics.truth import Truth


class Slot(Protocol):
    """One vehicle's place at the simulator."""

    @property
    def instance(self) -> int:
        """Its number."""

    @property
    def alive(self) -> bool:
        """Whether the vehicle is still in the run."""


class Vehicles(Protocol):
    """The step's rendezvous with the vehicles: see `harness.simulator.lockstep.Lockstep`."""

    @property
    def seats(self) -> Sequence[Slot]:
        """One per vehicle."""

    @property
    def living(self) -> int:
        """How many vehicles are in the run."""

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle is there."""

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Give every living vehicle its sensors."""

    def answers(self, time_us: int) -> ActuatorInbox:
        """What every vehicle answers to the sensors of ``time_us``; the same object in every step."""

    def judge(self, instances: Iterable[int]) -> None:
        """Decide on vehicles that have not done their part of the step."""

    def close(self) -> None:
        """Part with the vehicles."""


class ChannelInterface(Protocol):
    """The time master's side of the radio channel: see `harness.simulator.emulator_client.Air`."""

    extra_attenuation_db: float | None
    range_offsets_m: Mapping[int, float]
    busy_ns: int

    def is_awaited(self, time_us: int) -> bool:
        """Whether it has yet to end what the sensors of ``time_us`` tell of."""

    def delivered(self, time_us: int) -> tuple[int, ...]:
        """Vehicles whose radio has brought something for the step of ``time_us``."""

    def begins_at(self, time_us: int) -> bool:
        """Whether `begin` has to be called in the step of ``time_us``."""

    def begin(
        self,
        time_us: int,
        step_us: int,
        truth: Truth,
        *,
        senders: tuple[int, ...] = (),
        silent: tuple[int, ...] = (),
    ) -> None:
        """Let the air go on over the interval that begins now."""

    def end(self) -> tuple[int, ...]:
        """Wait until it has; returns the vehicles whose batches it misses."""

    def wait_on(self, silent: tuple[int, ...]) -> tuple[int, ...]:
        """Go on waiting for those, less the silent."""

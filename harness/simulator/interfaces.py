"""Interfaces of the simulation to its vehicles and to the radio channel, for sockets and for calls."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

from harness.simulator.actuator_inbox import ActuatorInbox
from harness.world.physics.truth import Truth


class Slot(Protocol):
    """One vehicle's slot at the simulator."""

    @property
    def instance(self) -> int:
        """The vehicle's number."""

    @property
    def alive(self) -> bool:
        """Whether the vehicle is still in the run."""


class Vehicles(Protocol):
    """The exchange with all vehicles in a step: see `harness.simulator.lockstep.Lockstep`."""

    @property
    def slots(self) -> Sequence[Slot]:
        """One per vehicle."""

    @property
    def living(self) -> int:
        """How many vehicles are in the run."""

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle is connected."""

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Send every living vehicle its sensor frames."""

    def receive(self, time_us: int) -> ActuatorInbox:
        """Return the answers of all vehicles to the sensors of ``time_us``; the same object in every step."""

    def check(self, instances: Iterable[int]) -> None:
        """Apply the response watchdog to vehicles that have not completed their part of the step."""

    def close(self) -> None:
        """Close the connections to all vehicles."""


class ChannelInterface(Protocol):
    """The radio channel of the time master: see `harness.simulator.emulator_client.EmulatorClient`."""

    extra_attenuation_db: float | None
    range_offsets_m: Mapping[int, float]
    busy_ns: int

    def is_pending(self, time_us: int) -> bool:
        """Whether an interval with deliveries due at ``time_us`` is not complete."""

    def delivered(self, time_us: int) -> tuple[int, ...]:
        """Return the vehicles whose radio has a delivery for the step of ``time_us``."""

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
        """Start the interval that begins at ``time_us``."""

    def end(self) -> tuple[int, ...]:
        """Wait until the interval is complete; returns the vehicles whose batches are missing."""

    def wait_on(self, silent: tuple[int, ...]) -> tuple[int, ...]:
        """Continue to wait for the missing batches, except those of ``silent`` vehicles."""

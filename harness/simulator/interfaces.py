"""Interface of the simulation to its vehicles, over sockets or by calls."""

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from harness.simulator.actuator_inbox import ActuatorInbox


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

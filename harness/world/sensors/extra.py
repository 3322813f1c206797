"""The scenario's own sensors of all vehicles: when they sample, and when their readings arrive. No I/O."""

from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from harness.world.active_faults import Faults
from harness.world.interfaces import Reading, WorldInputs
from harness.world.user_models import CheckedSensor


class Arrival(NamedTuple):
    """A reading that arrives in a step."""

    sensor: CheckedSensor
    reading: Reading


class _Pending(NamedTuple):
    arrives_us: int
    reading: Reading


class ExtraSensors:
    """The sensors, in the order of their numbers and then of the vehicles."""

    def __init__(self, sensors: Sequence[CheckedSensor], step_us: int) -> None:
        self._sensors = tuple((sensor, deque[_Pending]()) for sensor in sensors)
        self._step_us = step_us

    def __len__(self) -> int:
        return len(self._sensors)

    def sample(
        self,
        time_us: int,
        inputs_of: Callable[[int], WorldInputs],
        faults: Faults,
        lost: Collection[int],
    ) -> list[Arrival]:
        """Take the samples that are due at ``time_us`` and return the readings that arrive there.

        ``inputs_of`` returns the true state for a vehicle, ``lost`` vehicles are no longer in the run. Raises
        ExtensionFailure if code of the user fails.
        """
        arrivals: list[Arrival] = []
        for sensor, pending in self._sensors:
            if sensor.vehicle in lost:
                continue
            # a multiple of the period lies in the step that ends now
            if time_us // sensor.period_us != (time_us - self._step_us) // sensor.period_us:
                values = sensor.sample(inputs_of(sensor.vehicle))
                if values is not None:
                    changed = faults.reading(sensor.vehicle, sensor.name, values)
                    if changed is not None:
                        pending.append(_Pending(time_us + sensor.delay_us, Reading(time_us, changed)))
            while pending and pending[0].arrives_us <= time_us:
                arrivals.append(Arrival(sensor, pending.popleft().reading))
        return arrivals

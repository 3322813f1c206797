"""Readings of the scenario's own sensors in one step: recorded, and divided by their receivers."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.records.record_log import RecordLog
from harness.simulator.truth_record import SENSOR_RECORD
from harness.world.active_faults import Faults
from harness.world.interfaces import WorldInputs
from harness.world.sensors.extra import Arrival, ExtraSensors


class Readings(NamedTuple):
    """What arrives in one step."""

    with_sensors: tuple[Arrival, ...] = ()
    """For vehicles, with the messages of the other sensors."""
    to_applications: tuple[Arrival, ...] = ()
    """For applications beside other programs, which do not pass these readings on."""


NONE = Readings()


class ExtraReadings:
    """Samples, records and divides readings; ``external`` are the vehicles with another program's autopilot.

    ``log_path`` is that of the table of readings, without which there is none; ``open_log`` opens it.
    """

    def __init__(
        self,
        sensors: ExtraSensors,
        external: Collection[int],
        log_path: str | Path | None,
        *,
        open_log: Callable[[str | Path, np.dtype[Any]], RecordLog] = RecordLog,
    ) -> None:
        self._sensors = sensors
        self._is_empty = not len(sensors)
        self._external = external
        self._log = None if log_path is None else open_log(log_path, SENSOR_RECORD)

    def sample(
        self, time_us: int, inputs_of: Callable[[int], WorldInputs], faults: Faults, lost: Collection[int]
    ) -> Readings:
        """Sample all sensors; return the readings that arrive. Arguments as of `ExtraSensors.sample`."""
        if self._is_empty:
            return NONE
        arrivals = self._sensors.sample(time_us, inputs_of, faults, lost)
        if self._log is not None:
            self._log.append(
                (time_us, reading.measured_us, sensor.vehicle, sensor.name, column, value)
                for sensor, reading in arrivals
                for column, value in zip(sensor.columns, reading.values, strict=True)
            )
        return Readings(
            tuple(each for each in arrivals if not self._is_for_application(each)),
            tuple(each for each in arrivals if self._is_for_application(each)),
        )

    def close(self) -> None:
        """Write the table to its end."""
        if self._log is not None:
            self._log.close()

    def _is_for_application(self, arrival: Arrival) -> bool:
        sensor = arrival.sensor
        return sensor.vehicle in self._external and not sensor.is_for_autopilot

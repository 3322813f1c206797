"""Sensors and faults of a run by the names in its scenario, and the checks of what those of users return.

A name is that of a sensor that coflight ships, ``package.module:Class`` of a module in the folder of the
scenario's file or an installed one, or the name of an entry point of `SENSORS` or `FAULTS`. Every error is
one line that begins with the scenario's field.
"""

import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.parameters.config import Site
from foundation.airframe.description import Airframe
from foundation.extension_call import ExtensionCall
from foundation.extension_class import Extension, load_class
from foundation.extension_failure import MOST_CHARACTERS, ExtensionFailure
from foundation.extensions import ExtensionError
from harness.world.faults import AnyFault, UserFault
from harness.world.interfaces import Effects, Reading, WorldContext, WorldInputs
from harness.world.obstacles import Obstacles
from harness.world.sensors.config import MOST_NAME, ExtraSensor

SENSORS, FAULTS = "coflight.sensors", "coflight.faults"
"""Groups of entry points."""
SHIPPED = {
    "range_finder": "harness.world.sensors.range_finder:RangeFinder",
    "uwb_tag": "harness.world.sensors.uwb_tag:UwbTag",
}
"""Sensors by name; they are created as those of users."""
MOST_COLUMNS = 58
"""Capacity of DEBUG_FLOAT_ARRAY."""
MOST_ARRAY_NAME = 10
"""Characters of a name in DEBUG_FLOAT_ARRAY."""
MOST_PERIOD_US = 1_000_000_000
_SENSOR_STREAMS, _FAULT_STREAMS = 3, 4
"""First element of the keys of random streams; smaller ones are those of wind, sensors and faults."""


class WorldModels:
    """Creates the sensors and faults of a run.

    ``seed`` and ``stream`` select the random streams of the run, ``obstacles`` are those of its sensors.
    """

    def __init__(
        self, *, seed: int, stream: int, airframes: Sequence[Airframe], site: Site, obstacles: Obstacles,
        step_us: int,
    ) -> None:  # fmt: skip
        self._entropy = (seed, stream)
        self._airframes = tuple(airframes)
        self._site = site
        self._obstacles = obstacles
        self._step_us = step_us

    def sensors(self, choices: Sequence[ExtraSensor]) -> list["CheckedSensor"]:
        """Return all sensors, by their numbers and then by vehicle. Raises as `sensor`."""
        count = len(self._airframes)
        return [
            self.sensor(choice, number, vehicle)
            for number, choice in enumerate(choices)
            for vehicle in choice.vehicles(count)
        ]

    def sensor(self, choice: ExtraSensor, number: int, vehicle: int) -> "CheckedSensor":
        """Return the sensor ``number`` of a vehicle. Raises ExtensionError or ExtensionFailure."""
        extension = sensor_class(choice, number)
        key = (_SENSOR_STREAMS, zlib.crc32(choice.title.encode()), vehicle)
        return CheckedSensor(extension, self._context(vehicle, number, choice.title, choice.folder, key))

    def fault(self, fault: UserFault, number: int, vehicle: int) -> "CheckedFault":
        """Return the fault ``number`` of a vehicle. Raises ExtensionError or ExtensionFailure."""
        extension = fault_class(fault, f"faults[{number}]")
        key = (_FAULT_STREAMS, number, vehicle)
        return CheckedFault(extension, self._context(vehicle, number, fault.model, fault.folder, key))

    def _context(
        self, vehicle: int, number: int, name: str, folder: str, key: tuple[int, ...]
    ) -> WorldContext:
        return WorldContext(
            uav=vehicle,
            vehicles=len(self._airframes),
            number=number,
            name=name,
            airframe=self._airframes[vehicle],
            site=self._site,
            obstacles=self._obstacles,
            step_us=self._step_us,
            folder=Path(folder),
            rng=np.random.default_rng(np.random.SeedSequence(self._entropy, spawn_key=key)),
        )


def sensor_class(choice: ExtraSensor, number: int) -> Extension:
    """Return the class and the settings of a sensor. Raises ExtensionError."""
    field = f"sensors.extra[{number}]"
    return load_class(
        choice.model, SENSORS, _as_read(choice.settings), field=f"{field}.model",
        settings_field=f"{field}.settings", protocol="Sensor", members=("sample",), shipped=SHIPPED,
        search=Path(choice.folder),
    )  # fmt: skip


def fault_class(fault: UserFault, field: str) -> Extension:
    """Return the class and the settings of a user's fault. Raises ExtensionError."""
    return load_class(
        fault.model, FAULTS, _as_read(fault.settings), field=f"{field}.model",
        settings_field=f"{field}.settings", protocol="FaultModel", members=("update",),
        search=Path(fault.folder),
    )  # fmt: skip


def _as_read(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as another process reads them from a file."""
    values: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(settings))
    return values


def named(sensors: Iterable[ExtraSensor], faults: Iterable[AnyFault]) -> dict[str, tuple[str, str]]:
    """Return the names of all code of users, and its group of entry points, by field."""
    found = {
        f"sensors.extra[{number}]": (choice.model, SENSORS)
        for number, choice in enumerate(sensors)
        if choice.model not in SHIPPED
    }
    for number, fault in enumerate(faults):
        if isinstance(fault, UserFault):
            found[f"faults[{number}]"] = (fault.model, FAULTS)
    return found


class CheckedSensor:
    """A sensor of one vehicle; methods raise ExtensionFailure if it fails or returns anything wrong."""

    def __init__(self, extension: Extension, context: WorldContext) -> None:
        self._title = extension.title
        self.vehicle, self.name, self.number = context.uav, context.name, context.number
        self._model = extension.make(context)
        self.columns = self._columns()
        self.period_us = self._time_us("period_us", context.step_us)
        self.delay_us = self._time_us("delay_us", 0)
        self.is_for_autopilot = callable(getattr(self._model, "message", None))
        """Whether its readings are messages to the autopilot."""

    def sample(self, inputs: WorldInputs) -> tuple[float, ...] | None:
        """Return the values of a sample, NaN for None; None: no reading."""
        with ExtensionCall(f"{self._title}.sample"):
            result = self._model.sample(inputs)
        return None if result is None else self._values(result)

    def frame(self, reading: Reading, link: common.MAVLink) -> bytes:
        """Return the frame of a reading's message, with source and sequence number of ``link``."""
        message = self._message(reading) if self.is_for_autopilot else self._array(reading)
        try:
            frame: bytes = message.pack(link)
        except (struct.error, TypeError, ValueError, OverflowError) as error:
            raise self._wrong(
                "message", f"returned a {message.get_type()} that cannot be packed: {error}"
            ) from error
        return frame

    def _array(self, reading: Reading) -> Message:
        """Return the values of a reading as a message to the application."""
        unused = [0.0] * (MOST_COLUMNS - len(reading.values))
        return common.MAVLink_debug_float_array_message(
            reading.measured_us, self.name[:MOST_ARRAY_NAME].encode(), self.number, [*reading.values, *unused]
        )

    def _message(self, reading: Reading) -> Message:
        """Return the message of a reading to the autopilot."""
        with ExtensionCall(f"{self._title}.message"):
            message = self._model.message(reading)
        if not isinstance(message, common.MAVLink_message):
            raise self._wrong(
                "message", f"returned {type(message).__name__}; expected a message of pymavlink's common set"
            )
        if message.get_msgId() == common.MAVLINK_MSG_ID_HIL_SENSOR:
            raise self._wrong("message", "returned HIL_SENSOR, the vehicle's clock; expected another one")
        return message

    def _values(self, result: object) -> tuple[float, ...]:
        if not isinstance(result, tuple | list | np.ndarray):
            raise self._wrong(
                "sample", f"returned {type(result).__name__}; expected {len(self.columns)} numbers, or None"
            )
        values = tuple(result)
        if len(values) != len(self.columns):
            raise self._wrong("sample", f"returned {len(values)} values; expected {len(self.columns)}")
        return tuple(map(self._value, self.columns, values))

    def _value(self, column: str, value: object) -> float:
        if value is None:
            return math.nan
        if not isinstance(value, float | int | np.floating | np.integer):
            raise self._wrong("sample", f"returned {type(value).__name__} for {column}; expected a number")
        if not abs(float(value)) <= _MOST_VALUE:
            raise self._wrong("sample", f"returned {value:g} for {column}; expected a finite number, or None")
        return float(value)

    def _columns(self) -> tuple[str, ...]:
        columns: Any = getattr(self._model, "columns", None)
        is_list = isinstance(columns, list | tuple) and all(map(_is_name, columns))
        if not (is_list and 1 <= len(columns) <= MOST_COLUMNS and len({*columns}) == len(columns)):
            raise ExtensionError(
                f"{self._title}.columns: {str(columns)[:MOST_CHARACTERS]}; expected 1 to {MOST_COLUMNS} "
                f"different names, such as distance_m, of {MOST_NAME} characters at most"
            )
        return tuple(columns)

    def _time_us(self, name: str, least_us: int) -> int:
        value = getattr(self._model, name, None)
        if not isinstance(value, int) or not least_us <= value <= MOST_PERIOD_US:
            raise ExtensionError(
                f"{self._title}.{name}: {value!r}; expected a whole number, {least_us} to {MOST_PERIOD_US}"
            )
        return value

    def _wrong(self, method: str, what: str) -> ExtensionFailure:
        return ExtensionFailure(f"{self._title}.{method} {what[:MOST_CHARACTERS]} (UAV {self.vehicle})")


_MOST_VALUE = float(np.finfo(np.float32).max)
"""Limit of MAVLink's floats; NaN is beyond it, too."""


class CheckedFault:
    """A user's fault of one vehicle; methods raise ExtensionFailure if it fails or returns anything wrong."""

    def __init__(self, extension: Extension, context: WorldContext) -> None:
        self._title = extension.title
        self._vehicle = context.uav
        self._rotors = len(context.airframe.rotors)
        self._model = extension.make(context)
        self._changes_readings = callable(getattr(self._model, "reading", None))

    def update(self, inputs: WorldInputs, since_s: float) -> Effects:
        """Return the effects in a step; see `harness.world.interfaces.FaultModel`."""
        with ExtensionCall(f"{self._title}.update"):
            result = self._model.update(inputs, since_s)
        if not isinstance(result, Effects):
            raise self._wrong("update", f"returned {type(result).__name__}; expected coflight.Effects")
        try:
            effects = msgspec.convert(msgspec.to_builtins(result, enc_hook=_plain, str_keys=False), Effects)
        except (msgspec.ValidationError, TypeError, NotImplementedError) as error:
            reason, _, where = str(error).partition(" - at `$.")
            named = f"{where.rstrip('`')}: " if where else ""
            raise self._wrong("update", f"returned Effects with {named}{reason}") from None
        for rotor in (*effects.rotor_effectiveness, *effects.rotors_stopped):
            if rotor >= self._rotors:
                raise self._wrong("update", f"returned rotor {rotor}; expected 0 to {self._rotors - 1}")
        return effects

    def reading(self, sensor: str, values: Sequence[float]) -> Sequence[float] | None:
        """Return the values of a sample instead of ``values``; None: it is dropped."""
        if not self._changes_readings:
            return values
        with ExtensionCall(f"{self._title}.reading"):
            result = self._model.reading(sensor, values)
            changed = None if result is None else tuple(map(float, result))
        if changed is not None and len(changed) != len(values):
            raise self._wrong("reading", f"returned {len(changed)} values; expected {len(values)}, or None")
        if changed is not None and any(map(math.isinf, changed)):
            raise self._wrong("reading", "returned infinity; expected finite numbers, or NaN for no value")
        return changed

    def _wrong(self, method: str, what: str) -> ExtensionFailure:
        return ExtensionFailure(f"{self._title}.{method} {what[:MOST_CHARACTERS]} (UAV {self._vehicle})")


def _is_name(value: object) -> bool:
    return isinstance(value, str) and value.isascii() and 1 <= len(value) <= MOST_NAME


def _plain(value: object) -> object:
    """Return a NumPy array or number as Python's, for `msgspec.to_builtins`."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(f"a value of the type {type(value).__name__}")

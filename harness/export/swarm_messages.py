"""Messages of the swarm: events, log, formation error, antenna gain, readings of the user's sensors."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.export.json_rows import DIALECT, Schema, row_contents, schema_of
from harness.export.messages import Content, Message, Topic, frame_of
from harness.records.columns import GAINS, SENSORS
from harness.records.flight import Flight
from harness.records.pieces import GAIN_RECORD
from harness.report.formation_error import formation_error

FORMATION, GAIN = "/formation/error", "/antenna/gain"
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_ERROR_FIELDS: Mapping[str, Schema] = {
    "absolute_m": _NUMBERS
    | {"description": "Distance of each vehicle from its place; 0 for a lost vehicle. Unit: m."},
    "shape_m": _NUMBERS
    | {
        "description": "Distance of each vehicle from its place in the formation's best fit to the living "
        "vehicles; 0 for a lost vehicle. Unit: m."
    },
    "alive": {"type": "array", "items": {"type": "boolean"}, "description": "Whether each vehicle flies."},
    "absolute_rms_m": {
        "type": "number",
        "description": "RMS of `absolute_m` over the living vehicles. Unit: m.",
    },
    "shape_rms_m": {"type": "number", "description": "RMS of `shape_m` over the living vehicles. Unit: m."},
    "absolute_horizontal_rms_m": {"type": "number", "description": "The same, horizontal part. Unit: m."},
    "shape_horizontal_rms_m": {"type": "number", "description": "The same, horizontal part. Unit: m."},
    "yaw_rad": {
        "type": "number",
        "description": "Clockwise rotation of the flown against the desired formation. Unit: rad.",
    },
}


def formation_topic() -> Topic:
    """Return the topic of the formation's errors."""
    schema = {
        "$schema": DIALECT,
        "title": "coflight.FormationError",
        "description": "Errors of the formation at a recorded instant, as in summary.json.",
        "type": "object",
        "properties": {
            "time_us": {"type": "integer", "description": "Simulated time. Unit: µs."},
            **_ERROR_FIELDS,
        },
        "required": ["time_us", "absolute_m", "shape_m", "alive", "yaw_rad"],
    }
    return Topic(
        name=FORMATION,
        schema="coflight.FormationError",
        json_schema=schema,
        description="Errors of the formation, at every recorded instant from when it was reached.",
    )


def formation_messages(flight: Flight) -> Iterator[Message]:
    """Yield the errors at every instant of a flight."""
    error = formation_error(flight)
    series = {"absolute": error.absolute, "shape": error.shape}
    for t, time_us in enumerate(flight.time_us.tolist()):
        content: Content = {
            "time_us": time_us,
            "alive": flight.alive[t].tolist(),
            "yaw_rad": float(error.yaw_rad[t]),
        }
        for name, errors in series.items():
            content[f"{name}_m"] = errors.error_m[t].tolist()
            at = errors.at(slice(t, t + 1))
            valid = at.valid[0]
            if valid.any():
                content[f"{name}_rms_m"] = _rms(at.error_m[0, valid])
                content[f"{name}_horizontal_rms_m"] = _rms(at.horizontal_m[0, valid])
        yield Message(time_us * 1_000, FORMATION, content)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def gain_topic() -> Topic:
    """Return the topic of the antenna's gain."""
    return Topic(
        name=GAIN,
        schema="coflight.Gain",
        json_schema=schema_of("coflight.Gain", GAINS, GAIN_RECORD),
        description="A row of gains.parquet, then.",
    )


def gain_messages(rows: NDArray[Any]) -> Iterator[Message]:
    """Yield the gains (n,)."""
    contents = row_contents(rows, rows.dtype.names or ())
    for time_us, content in zip(rows["time_us"].tolist(), contents, strict=True):
        yield Message(time_us * 1_000, GAIN, content)


def sensor_name(uav: int, sensor: str) -> str:
    """Return the topic of a sensor."""
    return f"/{frame_of(uav)}/sensors/{sensor}"


def sensor_topic(uav: int, sensor: str, columns: Sequence[str]) -> Topic:
    """Return the topic of a vehicle's sensor whose readings have these columns."""
    times = np.dtype([("time_us", "i8"), ("measured_us", "i8")])
    values = {name: {"type": "number", "description": f"Value `{name}` of the sensor."} for name in columns}
    return Topic(
        name=sensor_name(uav, sensor),
        schema=f"coflight.sensors.{sensor}.uav{uav}",
        json_schema=schema_of(f"coflight.sensors.{sensor}.uav{uav}", SENSORS, times, more=values),
        description="A reading of one of the scenario's own sensors, when it arrives.",
    )


def sensor_messages(rows: NDArray[Any]) -> Iterator[Message]:
    """Yield the readings whose values are the rows (n,) of sensors.parquet."""

    def reading(row: tuple[Any, ...]) -> tuple[Any, ...]:
        return row[:4]

    for (time_us, measured_us, uav, sensor), values in groupby(rows.tolist(), reading):
        content: Content = {"time_us": time_us, "measured_us": measured_us}
        content |= {row[4].decode("ascii"): row[5] for row in values if np.isfinite(row[5])}
        yield Message(time_us * 1_000, sensor_name(uav, sensor.decode("ascii")), content)

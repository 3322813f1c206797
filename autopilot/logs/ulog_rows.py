"""ULog samples of the topics that are logged faster than full steps, from rows of many steps at once.

Rows are those of `autopilot.vehicle.shared_state.SAMPLE_ROW`, of full and of fast steps.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.logs.ulog_topics import DATA, NUMBER_OF, TOPICS
from autopilot.vehicle.shared_state import (
    ACCEL,
    ATTITUDE,
    GYRO,
    RATE_SETPOINT,
    RATES,
    THRUST,
    TIME,
    TORQUE,
)

Rows = NDArray[np.float64]
Columns = dict[str, Any]
"""Values (n, ...) by field."""
VIBRATION_WEIGHT = 0.01
"""Weight of the newest sample in the low-pass of PX4's vibration metrics."""
OF_ROWS = (
    "sensor_combined", "vehicle_angular_velocity", "vehicle_rates_setpoint", "vehicle_torque_setpoint",
    "vehicle_thrust_setpoint", "vehicle_attitude", "vehicle_acceleration", "vehicle_imu_status",
)  # fmt: skip
"""Topics of this module."""
_BEFORE = -1
_SINGLE_MAX = 3.0e38
"""Values beyond this limit of a float32 are clamped: an estimate has diverged."""


class RowEncoder:
    """Encodes the rows of one vehicle, block after block, as data messages."""

    def __init__(self) -> None:
        self._last: Rows | None = None
        """(1, ROW_VALUES) last row of the block before."""
        self._vibration = dict.fromkeys(("accel", "gyro", "coning"), 0.0)

    def encode(
        self, rows: Rows, *, yaw_resets: int, yaw_reset_rad: float, accel_bias_m_s2: Sequence[float]
    ) -> bytes:
        """Return the samples of rows (n, ROW_VALUES), n > 0, in the order of time within each topic.

        The reset of the yaw and the bias of the accelerometer are those of all rows.
        """
        rows = np.clip(rows, -_SINGLE_MAX, _SINGLE_MAX)
        first = rows[:1] if self._last is None else self._last
        before = np.concatenate((first, rows[:-1]))
        time_us, before_us = rows[:, TIME].astype(np.int64), before[:, TIME].astype(np.int64)
        if self._last is None:
            before_us[0] = _BEFORE  # the first sample begins each period
        turned = np.array((math.cos(0.5 * yaw_reset_rad), 0.0, 0.0, math.sin(0.5 * yaw_reset_rad)))
        dt_us = np.where(before_us < 0, 0, time_us - before_us)
        thrust = np.zeros((len(rows), 3))
        thrust[:, 2] = -rows[:, THRUST]
        rate = rows[:, RATE_SETPOINT:TORQUE]
        found: dict[str, Columns] = {
            "sensor_combined": {
                "gyro_rad": rows[:, GYRO:ATTITUDE], "accelerometer_m_s2": rows[:, ACCEL:GYRO],
                "gyro_integral_dt": dt_us, "accelerometer_integral_dt": dt_us,
            },
            "vehicle_angular_velocity": {
                "timestamp_sample": time_us, "xyz": rows[:, RATES:RATE_SETPOINT],
                "xyz_derivative": _rate(rows[:, RATES:RATE_SETPOINT], before[:, RATES:RATE_SETPOINT], dt_us),
            },
            "vehicle_rates_setpoint": {
                "roll": rate[:, 0], "pitch": rate[:, 1], "yaw": rate[:, 2], "thrust_body": thrust,
            },
            "vehicle_torque_setpoint": {"timestamp_sample": time_us, "xyz": rows[:, TORQUE:THRUST]},
            "vehicle_thrust_setpoint": {"timestamp_sample": time_us, "xyz": thrust},
            "vehicle_attitude": {
                "timestamp_sample": time_us, "q": rows[:, ATTITUDE:RATES],
                "delta_q_reset": np.broadcast_to(turned, (len(rows), 4)),
                "quat_reset_counter": np.full(len(rows), yaw_resets % 256),
            },
            "vehicle_acceleration": {
                "timestamp_sample": time_us, "xyz": rows[:, ACCEL:GYRO] - np.asarray(accel_bias_m_s2),
            },
        }  # fmt: skip
        data = b"".join(
            _messages(name, time_us, columns, _due(name, time_us, before_us, rows))
            for name, columns in found.items()
        )
        status = self._imu_status(rows, before, dt_us)
        at_end = np.array([len(rows) - 1])
        data += _messages(
            "vehicle_imu_status", time_us, {name: np.array([value]) for name, value in status.items()}, at_end
        )
        self._last = rows[-1:].copy()
        return data

    def _imu_status(self, rows: Rows, before: Rows, dt_us: NDArray[np.int64]) -> Columns:
        """Return the fields of vehicle_imu_status of a block; the metrics are those of PX4, low-passed."""
        accel, gyro, gyro_before = rows[:, ACCEL:GYRO], rows[:, GYRO:ATTITUDE], before[:, GYRO:ATTITUDE]
        dt_s = dt_us * 1e-6
        steps = {
            "accel": np.linalg.norm(accel - before[:, ACCEL:GYRO], axis=1),
            "gyro": np.linalg.norm(gyro - gyro_before, axis=1),
            "coning": dt_s**2 * np.linalg.norm(np.cross(gyro, gyro_before), axis=1),
        }
        fading = (1.0 - VIBRATION_WEIGHT) ** np.arange(len(rows) - 1, -1, -1.0)
        metric = self._vibration
        for name, values in steps.items():
            kept = metric[name] * (1.0 - VIBRATION_WEIGHT) ** len(rows)
            metric[name] = float(kept + VIBRATION_WEIGHT * (fading @ values))
        total_s = float(dt_s.sum())
        rate_hz = np.count_nonzero(dt_us) / total_s if total_s > 0.0 else math.nan
        rates = dict.fromkeys(
            ("accel_rate_hz", "gyro_rate_hz", "accel_raw_rate_hz", "gyro_raw_rate_hz"), rate_hz
        )
        return rates | {
            "accel_vibration_metric": metric["accel"], "gyro_vibration_metric": metric["gyro"],
            "delta_angle_coning_metric": metric["coning"], "mean_accel": accel.mean(axis=0),
            "mean_gyro": gyro.mean(axis=0), "var_accel": accel.var(axis=0), "var_gyro": gyro.var(axis=0),
            "temperature_accel": math.nan, "temperature_gyro": math.nan,
        }  # fmt: skip


def _due(
    name: str, time_us: NDArray[np.int64], before_us: NDArray[np.int64], rows: Rows
) -> NDArray[np.int64]:
    """Return the indices of the rows that a topic samples: the first ones in each period."""
    period_us = TOPICS[NUMBER_OF[name]].period_us
    chosen = np.ones(len(rows), np.bool_) if not period_us else time_us // period_us > before_us // period_us
    if name in {"vehicle_attitude", "vehicle_angular_velocity"}:
        chosen &= ~np.isnan(rows[:, ATTITUDE])  # before the alignment there is no attitude
    return np.flatnonzero(chosen)


def _messages(name: str, time_us: NDArray[np.int64], columns: Columns, chosen: NDArray[np.int64]) -> bytes:
    """Return the messages of some rows. ``columns`` have the values of all rows, or of the chosen ones."""
    number = NUMBER_OF[name]
    topic = TOPICS[number]
    samples = np.zeros(len(chosen), _DTYPES[name])
    samples["size"], samples["kind"], samples["topic"] = topic.size, DATA, number
    samples["timestamp"] = time_us[chosen]
    for field, values in columns.items():
        samples[field] = values[chosen] if len(values) == len(time_us) else values
    return samples.tobytes()


def _rate(values: Rows, before: Rows, dt_us: NDArray[np.int64]) -> Rows:
    """Return the differences (n, 3) per second; 0 where no time has passed."""
    dt_s = np.where(dt_us > 0, dt_us, 1)[:, np.newaxis] * 1e-6
    return np.where(dt_us[:, np.newaxis] > 0, (values - before) / dt_s, 0.0)


_DTYPES = {name: TOPICS[NUMBER_OF[name]].dtype for name in OF_ROWS}

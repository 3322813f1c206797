"""Fast step: a step with only an inertial sample, compiled from the received bytes to the bytes of the reply.

Nine of ten steps are fast: no other measurement is used, nothing is due, and the vehicle continues on the
same trajectory or is disarmed. `inertial_step` is equivalent to `autopilot.vehicle.vehicle.Vehicle.step`: it
runs the same kernels on the same blocks of memory, so the flight is identical to the bit. This saves several
times the time of the arithmetic, because a process that shares its processor with others starts each step
with cold caches.

The table in `autopilot.vehicle.shared_state` has the limits of a run of fast steps. `inertial_step` also
rejects bytes that are not exactly one valid HIL_SENSOR of the first sensor set, or that have a time that is
not later, other values than acceleration and body rates, or implausible ones.
"""

import numpy as np
from numba import njit

from autopilot.control.cascade import follow_trajectory
from autopilot.control.state import CascadeState
from autopilot.estimation.horizon import NOT_FINITE, OMEGA, Horizon, advance
from autopilot.estimation.sensor_input import BARO_FIELDS, IMU_FIELDS, MAG_FIELDS
from autopilot.mavlink.frame import FIRST, HEADER_BYTES, PAYLOAD, Octets, payload_bytes, seal
from autopilot.mavlink.hil import HilMessage, HilSensor, unpack
from autopilot.mavlink.hil_schema import HIL_ACTUATOR_CONTROLS, HIL_SENSOR
from autopilot.vehicle.shared_state import (
    ACCEL,
    ATTITUDE,
    GYRO,
    MOST_ROWS,
    RATE_SETPOINT,
    RATES,
    THRUST,
    TIME,
    TORQUE,
)
from foundation.kernels.inner import constant, inner
from foundation.kernels.records import Records
from foundation.types import Array
from netsim.wire.lockstep import BATCH_HANDED_OVER

_SENSOR_ID, _SENSOR_EXTRA = constant(HIL_SENSOR.message_id), constant(HIL_SENSOR.crc_extra)
_SENSOR = HIL_SENSOR.dtype
_SENSOR_END = PAYLOAD + HIL_SENSOR.payload_bytes
_UPDATED = HIL_SENSOR.offset("fields_updated")
_LEAST_BYTES, _MOST_BYTES = _UPDATED + 1, _UPDATED + 2
"""Payload lengths of HIL_SENSOR: trailing zeros are truncated; ``fields_updated`` needs one or two bytes,
``id`` none."""
_ANSWER, _ANSWER_EXTRA = HIL_ACTUATOR_CONTROLS.dtype, constant(HIL_ACTUATOR_CONTROLS.crc_extra)
_ANSWER_END = PAYLOAD + HIL_ACTUATOR_CONTROLS.payload_bytes
_AIDS = MAG_FIELDS | BARO_FIELDS
_HANDED_OVER = HEADER_BYTES + HIL_ACTUATOR_CONTROLS.offset("flags") + 4
_HANDED_OVER_BIT = BATCH_HANDED_OVER >> 32
"""Offset of a byte of the flags in a frame, and the bit in it."""
_RECEIVE_BYTES = 4096
US_PER_S = 1_000_000
Blocks = tuple[Records, Records, Records, Records]
"""Those of the shared state, the filter, its waiting samples, and the controller."""


@njit(cache=True)
def within_limits(limits: np.void, time_us: int, horizon_us: int, aids: int) -> bool:
    """Return whether a sample of this time reaches none of the limits, a record of `shared_state.LIMITS`.

    ``horizon_us`` is the greatest time of the filter's horizon after the sample; ``aids`` is not 0 if a
    magnetic field or pressure comes with it.
    """
    return bool(
        time_us < limits["decision_us"]
        and time_us < limits["application_us"]
        and time_us < limits["services_us"]
        and time_us < limits["record_us"]
        and (aids == 0 or time_us < limits["aiding_us"])
        and horizon_us < limits["horizon_us"]
    )


@inner
def _append_row(
    log: np.void, time_us: int, accel: Array, gyro: Array, estimate: Array, cascade: CascadeState
) -> None:
    """Append the row of a sample; see `shared_state.SAMPLE_ROW`."""
    row = log["rows"][log["count"]]
    row[TIME] = time_us
    for i in range(3):
        row[ACCEL + i], row[GYRO + i] = accel[i], gyro[i]
        row[RATES + i] = estimate[OMEGA + i]
        row[RATE_SETPOINT + i], row[TORQUE + i] = cascade.rate_setpoint_frd_rad_s[i], cascade.torque[i]
    for i in range(4):
        row[ATTITUDE + i] = estimate[i]
    row[THRUST] = cascade.allocation.thrust
    log["count"] += 1


@njit(cache=True)
def inertial_step(
    size: int, incoming: Octets, answer: Octets,
    shared: Records, horizon: Records, samples: Records, cascade: Records,
) -> bool:  # fmt: skip
    """Process ``size`` received bytes if they are a fast step, and write the reply.

    Returns False, with nothing changed, if they are not. ``incoming`` and ``answer`` contain frames starting
    at `frame.FIRST`; ``answer`` has the previous reply, of which sequence number, time, controls and checksum
    are updated. ``shared`` is (1,) of `shared_state.SHARED_STATE`, the others are as in `Blocks`.
    """
    state = shared[0]
    filtered: Horizon = horizon[0]
    clock = state["clock"]
    length = payload_bytes(incoming, size, _SENSOR_ID, _SENSOR_EXTRA)
    if length < _LEAST_BYTES or length > _MOST_BYTES:
        return False
    sensor = incoming[PAYLOAD:_SENSOR_END].view(_SENSOR)[0]
    updated = np.int64(sensor["fields_updated"]) & ((1 << 8 * (length - _UPDATED)) - 1)
    time_us = int(np.int64(sensor["time_usec"]))
    if updated & ~_AIDS != IMU_FIELDS or time_us <= clock["now_us"]:
        return False
    if not within_limits(state["limits"], time_us, time_us - filtered.delay_us, int(updated & _AIDS)):
        return False
    if filtered.waiting + 1 >= samples.size:  # a full ring buffer would advance the horizon further
        return False
    log = state["samples"]
    if log["count"] >= MOST_ROWS:
        return False
    accel, gyro = np.empty(3), np.empty(3)
    accel[0], accel[1], accel[2] = sensor["xacc"], sensor["yacc"], sensor["zacc"]
    gyro[0], gyro[1], gyro[2] = sensor["xgyro"], sensor["ygyro"], sensor["zgyro"]
    dt_s = (time_us - clock["estimate_us"]) * 1e-6
    if advance(horizon, samples, time_us, dt_s, gyro, accel) == NOT_FINITE:
        return False

    reply = answer[PAYLOAD:_ANSWER_END].view(_ANSWER)[0]
    if state["flies"]:
        c: CascadeState = cascade[0]
        c.dt_s = (time_us - clock["now_us"]) / US_PER_S  # the other inputs are unchanged
        follow_trajectory(cascade, filtered.estimate[:])
        for i in range(c.allocation.rotors):
            reply["controls"][i] = c.allocation.controls[i]
    clock["now_us"] = clock["inertial_us"] = clock["estimate_us"] = time_us
    reply["time_usec"] = time_us
    if log["open"]:
        _append_row(log, time_us, accel, gyro, filtered.estimate[:], cascade[0])
    seal(answer, state["sequence"], _ANSWER_EXTRA)
    state["sequence"] = (state["sequence"] + 1) % 256
    return True


class FastSteps:
    """The fast steps of one vehicle: `open` after a full step, `close` before the next one.

    Attributes:
        incoming: buffer for the simulator's bytes of the next step.

    """

    def __init__(self) -> None:
        incoming = np.zeros(FIRST + _RECEIVE_BYTES, np.uint8)
        answer = np.zeros(FIRST + HIL_ACTUATOR_CONTROLS.frame_bytes, np.uint8)
        self.incoming = incoming.data[FIRST:]
        self._answer = answer.data[FIRST:]
        self._octets = (incoming, answer)
        self._blocks: Blocks | None = None
        self._ran = False

    def step(self, size: int) -> memoryview | None:
        """Return the reply to ``size`` received bytes; None, with nothing changed, if not a fast step."""
        if self._blocks is not None and inertial_step(size, *self._octets, *self._blocks):
            self._ran = True
            return self._answer
        return None

    def open(self, answer: bytes, blocks: Blocks) -> None:
        """Allow fast steps after the full step whose reply is the frame ``answer``."""
        self._answer[:] = answer
        self._answer[_HANDED_OVER] &= ~_HANDED_OVER_BIT
        self._blocks, self._ran = blocks, False

    def close(self) -> bool:
        """End the fast steps; return whether there were any."""
        ran, self._blocks, self._ran = self._ran, None, False
        return ran

    @property
    def last_sensor(self) -> HilMessage:
        """HIL_SENSOR of the last fast step, until `incoming` is overwritten."""
        length = self.incoming[1]
        return unpack(HilSensor, bytes(self.incoming[HEADER_BYTES : HEADER_BYTES + length]))

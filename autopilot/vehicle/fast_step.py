"""Fast step: a step with only an inertial sample, compiled from the received bytes to the bytes of the reply.

Nine of ten steps are fast: no other measurement is used, nothing is due, and the vehicle continues on the
same trajectory or is disarmed. `inertial_step` is equivalent to `autopilot.vehicle.vehicle.Vehicle.step`: it
runs the same kernels on the same blocks of memory, so the flight is identical to the bit. It does not update
the Python objects; they are synchronised before they are next used (`Vehicle.catch_up`). This saves several
times the time of the arithmetic, because a process that shares its processor with others starts each step
with cold caches.
"""

from collections.abc import Sequence
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.control.block import Block as Cascade
from autopilot.control.cascade import follow_trajectory
from autopilot.estimation.horizon import DELAY_US, NOT_FINITE, WAITING, advance
from autopilot.estimation.horizon import Block as Horizon
from autopilot.estimation.sensor_input import BARO_FIELDS, IMU_FIELDS, MAG_FIELDS
from autopilot.mavlink.frame import CHECKSUM_BYTES, FIRST, HEADER_BYTES, PAYLOAD, Octets, payload_bytes, seal
from autopilot.mavlink.hil import HilSensor
from autopilot.mavlink.hil_layout import (
    ACTUATORS_BYTES,
    ACTUATORS_CONTROLS,
    ACTUATORS_EXTRA,
    ACTUATORS_FLAGS,
    ACTUATORS_MODE,
    ACTUATORS_TIME,
    SENSOR_BYTES,
    SENSOR_EXTRA,
    SENSOR_FLOATS,
    SENSOR_KIND,
    SENSOR_UPDATED,
)
from netsim.wire.lockstep import BATCH_HANDED_OVER

_LEAST_BYTES, _MOST_BYTES = 61, 62
"""Payload lengths of HIL_SENSOR: trailing zeros are truncated; ``fields_updated`` needs one or two bytes,
``id`` none."""
_AIDS = MAG_FIELDS | BARO_FIELDS
_HANDED_OVER, _HANDED_OVER_BIT = ACTUATORS_FLAGS - FIRST + 4, BATCH_HANDED_OVER >> 32
"""Offset of a byte of the flags in a frame, and the bit in it."""
_ROTORS = 4
_RECEIVE_BYTES = 4096
US_PER_S = 1_000_000

FAST_STEP_STATE = np.dtype(
    [
        ("now_us", "i8"), ("until_us", "i8"), ("aids_us", "i8"), ("sound_until_us", "i8"), ("sequence", "i8"),
        ("flies", "i8"),
    ],
    align=True,
)  # fmt: skip
"""Inputs of `FastSteps.open`; a step updates its time and the sequence number of the next frame."""
_MOMENT = Struct("=6q")
"""The same fields for Python, because single writes to a row of an array are slow."""


@njit(cache=True)
def inertial_step(
    size: int,
    incoming: Octets,
    answer: Octets,
    moment: NDArray[np.void],
    horizon: Horizon,
    samples: Horizon,
    cascade: Cascade,
) -> bool:
    """Process ``size`` received bytes if they are a fast step, and write the reply.

    Returns False, with nothing changed, if they are not. ``incoming`` and ``answer`` contain frames starting
    at `frame.FIRST`; ``answer`` has the previous reply, of which sequence number, time, controls and checksum
    are updated. ``moment`` is (1,) of `FAST_STEP_STATE`.
    """
    m, filtered = moment[0], horizon[0]
    length = payload_bytes(incoming, size, SENSOR_KIND, SENSOR_EXTRA)
    if length < _LEAST_BYTES or length > _MOST_BYTES:
        return False
    updated = np.int64(incoming[SENSOR_UPDATED])
    if length == _MOST_BYTES:
        updated |= np.int64(incoming[SENSOR_UPDATED + 1]) << 8
    time_us = incoming[PAYLOAD:SENSOR_FLOATS].view(np.int64)[0]
    if updated & ~_AIDS != IMU_FIELDS or (updated & _AIDS and time_us >= m["aids_us"]):
        return False
    cursor = filtered["cursor"]
    if not m["now_us"] < time_us < m["until_us"] or time_us - cursor[DELAY_US] >= m["sound_until_us"]:
        return False
    if cursor[WAITING] + 1 >= samples.size:  # a full ring buffer would advance the horizon further
        return False
    measured = incoming[SENSOR_FLOATS:SENSOR_UPDATED].view(np.float32)
    accel, gyro = np.empty(3), np.empty(3)
    for i in range(3):
        accel[i], gyro[i] = measured[i], measured[3 + i]
    if advance(horizon, samples, time_us, gyro, accel) == NOT_FINITE:
        return False

    if m["flies"]:
        c = cascade[0]
        c["dt_s"] = (time_us - m["now_us"]) / US_PER_S  # the other inputs in the block are unchanged
        follow_trajectory(cascade, filtered["estimate"])
        controls, given = c["controls"], answer[ACTUATORS_CONTROLS:ACTUATORS_MODE].view(np.float32)
        for i in range(_ROTORS):
            given[i] = controls[i]
    m["now_us"] = time_us

    answer[ACTUATORS_TIME:ACTUATORS_FLAGS].view(np.int64)[0] = time_us
    seal(answer, m["sequence"], ACTUATORS_EXTRA)
    m["sequence"] = (m["sequence"] + 1) % 256
    return True


class FastSteps:
    """The fast steps of one vehicle: `open` after a full step, `close` before the next one.

    Attributes:
        incoming: buffer for the simulator's bytes of the next step.

    """

    def __init__(self) -> None:
        incoming = np.zeros(FIRST + _RECEIVE_BYTES, np.uint8)
        answer = np.zeros(PAYLOAD + ACTUATORS_BYTES + CHECKSUM_BYTES, np.uint8)
        self.incoming = incoming.data[FIRST:]
        self._answer = answer.data[FIRST:]
        self._moment: NDArray[np.void] = np.zeros(1, FAST_STEP_STATE)
        self._moment_octets = self._moment.view(np.uint8).data
        self._octets = (incoming, answer, self._moment)
        self._blocks: Sequence[Horizon | Cascade] | None = None
        self._opened_us = 0

    def step(self, size: int) -> memoryview | None:
        """Return the reply to ``size`` received bytes; None, with nothing changed, if not a fast step."""
        if self._blocks is not None and inertial_step(size, *self._octets, *self._blocks):
            return self._answer
        return None

    def open(
        self, answer: bytes, sequence: int, blocks: tuple[Horizon, Horizon, Cascade], *, now_us: int,
        until_us: int, next_aiding_us: int, valid_until_us: int, flies: bool,
    ) -> None:  # fmt: skip
        """Allow fast steps after the full step whose reply is this frame.

        Args:
            answer: the frame.
            sequence: sequence number of the next frame.
            blocks: those of the filter, its waiting samples, and the controller.
            now_us: time of the last sample.
            until_us: time of the next full step.
            next_aiding_us: time from which magnetometer and barometer are used; earlier readings are skipped.
            valid_until_us: horizon until which nothing is to be fused and the state stays valid.
            flies: the last trajectory continues; else the controls are constant.

        """
        self._answer[:] = answer
        self._answer[_HANDED_OVER] &= ~_HANDED_OVER_BIT
        self._opened_us = now_us
        _MOMENT.pack_into(
            self._moment_octets, 0, now_us, until_us, next_aiding_us, valid_until_us, sequence, flies
        )
        self._blocks = blocks

    def close(self) -> tuple[int, int] | None:
        """End the fast steps; return the last time and the next sequence number, None if none ran."""
        if self._blocks is None:
            return None
        self._blocks = None
        now_us, _, _, _, sequence, _ = _MOMENT.unpack_from(self._moment_octets)
        return None if now_us == self._opened_us else (now_us, sequence)

    @property
    def last_sensor(self) -> HilSensor:
        """HIL_SENSOR of the last fast step, until `incoming` is overwritten."""
        length = self.incoming[1]
        payload = bytes(self.incoming[HEADER_BYTES : HEADER_BYTES + length])
        return HilSensor.from_payload(payload.ljust(SENSOR_BYTES, b"\0"))

"""A step that needs nothing but its inertial sample: compiled, from the bytes that come to the answer's.

Nine steps of ten are like that: nothing else has come that is taken, nothing is due, and the vehicle follows
the trajectory that it followed before, or stands disarmed. `inertial_step` then does what
`autopilot.vehicle.vehicle.Vehicle.step` does, with the same kernels on the same blocks of memory, so it is
the same flight to the bit. It leaves Python's objects alone: whoever looks at them next brings them up to
date first. That is worth several times the arithmetic, since a process that shares its processor with others
finds nothing of what it needs in the caches.
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
"""Lengths of HIL_SENSOR's payload: zeros are cut off, ``fields_updated`` needs a byte or two, ``id`` none."""
_AIDS = MAG_FIELDS | BARO_FIELDS
_HANDED_OVER, _HANDED_OVER_BIT = ACTUATORS_FLAGS - FIRST + 4, BATCH_HANDED_OVER >> 32
"""Where in a frame one of the flags is, and which bit."""
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
"""What `FastSteps.open` is told, of which the last step's time and the next frame's number go on."""
_MOMENT = Struct("=6q")
"""The same for Python, to which a row of an array is slow to write."""


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
    """Make the step of ``size`` bytes that have come, if it is one of these: the answer is then written.

    False: nothing has been touched. ``incoming`` and ``answer`` have frames from `frame.FIRST` on; the answer
    is the last one, of whose frame sequence number, time, controls and checksum change. ``moment`` is (1,) of
    `FAST_STEP_STATE`.
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
    if cursor[WAITING] + 1 >= samples.size:  # a full ring moves the horizon further
        return False
    measured = incoming[SENSOR_FLOATS:SENSOR_UPDATED].view(np.float32)
    accel, gyro = np.empty(3), np.empty(3)
    for i in range(3):
        accel[i], gyro[i] = measured[i], measured[3 + i]
    if advance(horizon, samples, time_us, gyro, accel) == NOT_FINITE:
        return False

    if m["flies"]:
        c = cascade[0]
        c["dt_s"] = (time_us - m["now_us"]) / US_PER_S  # what else is laid out in the block is as it was
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
    """These steps of one vehicle, between the others: `open` after one of those, `close` before the next.

    Attributes:
        incoming: where the simulator's bytes go before each step.

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
        """Answer ``size`` bytes that have come; None: they are no step of this kind, and nothing happened."""
        if self._blocks is not None and inertial_step(size, *self._octets, *self._blocks):
            return self._answer
        return None

    def open(
        self, answer: bytes, sequence: int, blocks: tuple[Horizon, Horizon, Cascade], *, now_us: int,
        until_us: int, next_aiding_us: int, valid_until_us: int, flies: bool,
    ) -> None:  # fmt: skip
        """Let such steps follow the one that was answered by this frame.

        Args:
            answer: the frame.
            sequence: number of the next one.
            blocks: the filter's, the samples that wait for it, and the controller's.
            now_us: time of the last sample.
            until_us: when there is the next look at anything but such samples.
            aids_us: from when on a reading of magnetometer or barometer is taken; before, they are passed
                over.
            sound_until_us: up to when the filter's horizon finds nothing to fuse, and the state stays valid.
            flies: the trajectory is followed that was followed last; else the controls stay as they are.

        """
        self._answer[:] = answer
        self._answer[_HANDED_OVER] &= ~_HANDED_OVER_BIT
        self._opened_us = now_us
        _MOMENT.pack_into(
            self._moment_octets, 0, now_us, until_us, next_aiding_us, valid_until_us, sequence, flies
        )
        self._blocks = blocks

    def close(self) -> tuple[int, int] | None:
        """End them; returns time of the last and number of the next frame, None if there were none."""
        if self._blocks is None:
            return None
        self._blocks = None
        now_us, _, _, _, sequence, _ = _MOMENT.unpack_from(self._moment_octets)
        return None if now_us == self._opened_us else (now_us, sequence)

    @property
    def last_sensor(self) -> HilSensor:
        """What the last of them was of, until other bytes come."""
        length = self.incoming[1]
        payload = bytes(self.incoming[HEADER_BYTES : HEADER_BYTES + length])
        return HilSensor.from_payload(payload.ljust(SENSOR_BYTES, b"\0"))

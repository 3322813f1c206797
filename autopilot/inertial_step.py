"""A step that brings an inertial sample and nothing else: compiled, from the bytes that come to the answer's.

Three steps of four are like that: nothing else has come, nothing is due, and the vehicle follows the
trajectory that it followed before, or stands disarmed. `inertial_step` then does what
`autopilot.vehicle.Vehicle.step` does, with the same kernels on the same blocks of memory, so it is the same
flight to the bit. It leaves Python's objects alone: whoever looks at them next brings them up to date first.
That is worth several times the arithmetic, since a process that shares its processor with others finds
nothing of what it needs in the caches.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.control.block import Block as Cascade
from autopilot.control.cascade import follow_trajectory
from autopilot.estimation.horizon import (
    ACC,
    DELAY_US,
    OMEGA,
    STD,
    WAITING,
    advance,
)
from autopilot.estimation.horizon import Block as Horizon
from autopilot.estimation.kernels import GYRO_BIAS, POS, VEL, is_plausible
from autopilot.mavlink.checksum import Octets, checksum
from autopilot.mavlink.hil import HilActuatorControls, HilSensor, pack
from autopilot.sensors import IMU_FIELDS

_MAGIC = 0xFD
_FIRST = 6
"""Where frames begin in their buffers, so that payloads are aligned for the numbers in them."""
_PAYLOAD = _FIRST + 10
_CHECKSUM_BYTES = 2
_LENGTH, _INCOMPATIBLE, _SEQUENCE, _KIND = _FIRST + 1, _FIRST + 2, _FIRST + 4, _FIRST + 7

# HIL_SENSOR: time in eight bytes, then floats, acceleration and rates first, then what of it is new
_SENSOR_KIND = common.MAVLINK_MSG_ID_HIL_SENSOR
_SENSOR_EXTRA = common.mavlink_map[_SENSOR_KIND].crc_extra
_SENSOR_BYTES = 61
"""Length of its payload: ``fields_updated`` is small and ``id`` zero, and trailing zeros are cut off."""
_SENSOR_END = _PAYLOAD + _SENSOR_BYTES
_WHOLE_SENSOR_BYTES = 65
_FLOATS = _PAYLOAD + 8
_UPDATED = _PAYLOAD + 60
# HIL_ACTUATOR_CONTROLS: time and flags in eight bytes each, sixteen floats, the mode
_ACTUATORS_KIND = common.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS
_ACTUATORS_EXTRA = common.mavlink_map[_ACTUATORS_KIND].crc_extra
_ACTUATORS_BYTES = 81
_ACTUATORS_END = _PAYLOAD + _ACTUATORS_BYTES
_CONTROLS = _PAYLOAD + 16
_ROTORS = 4
_RECEIVE_BYTES = 4096
US_PER_S = 1_000_000
# where these steps are made at all
_VELOCITY_VALID, _IDLES, _LANDED, _FLIES = True, False, False, True

MOMENT = np.dtype(
    [("now_us", "i8"), ("until_us", "i8"), ("sound_until_us", "i8"), ("sequence", "i8"), ("flies", "i8")],
    align=True,
)
"""The last step's time, that from which steps are no longer these, the horizon's from which there is
something to fuse or the estimate may not be valid, the next frame's number, and whether the vehicle flies."""


class Ahead(NamedTuple):
    """A vehicle between two steps that look at more than inertial samples."""

    last: HilActuatorControls
    """Its answer to the last sample"""
    flies: bool
    """It follows a trajectory; else its controls stay as they are."""
    until_us: int
    """When the next of those is"""
    sound_until_us: int
    """Up to when the filter's horizon finds nothing to fuse, and the state stays valid"""
    horizon: Horizon
    samples: Horizon
    cascade: Cascade


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

    False: nothing has been touched. ``incoming`` and ``answer`` have frames from `_FIRST` on; the answer is
    the last one, of whose frame sequence number, time, controls and checksum change. ``moment`` is (1,) of
    `MOMENT`.
    """
    m, filtered = moment[0], horizon[0]
    if size != _SENSOR_END - _FIRST + _CHECKSUM_BYTES or incoming[_UPDATED] != IMU_FIELDS:
        return False
    if incoming[_FIRST] != _MAGIC or incoming[_LENGTH] != _SENSOR_BYTES or incoming[_INCOMPATIBLE] != 0:
        return False
    if incoming[_KIND] != _SENSOR_KIND or incoming[_KIND + 1] != 0 or incoming[_KIND + 2] != 0:
        return False
    found = np.int64(incoming[_SENSOR_END]) | np.int64(incoming[_SENSOR_END + 1]) << 8
    if found != checksum(incoming, _FIRST + 1, _SENSOR_END, _SENSOR_EXTRA):
        return False
    time_us = incoming[_PAYLOAD:_FLOATS].view(np.int64)[0]
    cursor = filtered["cursor"]
    if not m["now_us"] < time_us < m["until_us"] or time_us - cursor[DELAY_US] >= m["sound_until_us"]:
        return False
    if cursor[WAITING] + 1 >= samples.size:  # a full ring moves the horizon further
        return False
    measured = incoming[_FLOATS:_UPDATED].view(np.float32)
    accel, gyro = np.empty(3), np.empty(3)
    for i in range(3):
        accel[i], gyro[i] = measured[i], measured[3 + i]
    if not is_plausible(gyro, accel):
        return False

    advance(horizon, samples, time_us, gyro, accel)
    if m["flies"]:
        estimate = filtered["estimate"]
        follow_trajectory(
            cascade, estimate[:VEL], estimate[OMEGA:STD], estimate[POS:GYRO_BIAS], estimate[VEL:POS],
            estimate[ACC:OMEGA], _VELOCITY_VALID, (time_us - m["now_us"]) / US_PER_S, _IDLES, _LANDED, _FLIES,
        )  # fmt: skip
        controls, given = cascade[0]["controls"], answer[_CONTROLS : _ACTUATORS_END - 1].view(np.float32)
        for i in range(_ROTORS):
            given[i] = controls[i]
    m["now_us"] = time_us

    answer[_SEQUENCE] = m["sequence"]
    m["sequence"] = (m["sequence"] + 1) % 256
    answer[_PAYLOAD:_FLOATS].view(np.int64)[0] = time_us
    crc = checksum(answer, _FIRST + 1, _ACTUATORS_END, _ACTUATORS_EXTRA)
    answer[_ACTUATORS_END], answer[_ACTUATORS_END + 1] = crc & 0xFF, crc >> 8
    return True


class InertialSteps:
    """These steps of one vehicle, between the others: `open` after one of those, `close` before the next.

    Attributes:
        incoming: where the simulator's bytes go before each step.

    """

    def __init__(self, *, system: int, component: int) -> None:
        """Answer as this component of this system."""
        self._own = (system, component)
        incoming = np.zeros(_FIRST + _RECEIVE_BYTES, np.uint8)
        answer = np.zeros(_ACTUATORS_END + _CHECKSUM_BYTES, np.uint8)
        self.incoming = incoming.data[_FIRST:]
        self._answer = answer.data[_FIRST:]
        self._moment: NDArray[np.void] = np.zeros(1, MOMENT)
        self._octets = (incoming, answer, self._moment)
        self._blocks: tuple[Horizon, Horizon, Cascade] | None = None
        self._opened_us = 0

    def step(self, size: int) -> memoryview | None:
        """Answer ``size`` bytes that have come; None: they are no step of this kind, and nothing happened."""
        if self._blocks is not None and inertial_step(size, *self._octets, *self._blocks):
            return self._answer
        return None

    def open(self, ahead: Ahead, sequence: int) -> None:
        """Let such steps follow; ``sequence`` is the number of the next answer's frame."""
        system, component = self._own
        self._answer[:] = pack(ahead.last, sequence=sequence, system=system, component=component)
        self._opened_us = now_us = ahead.last.time_usec
        self._moment[0] = (now_us, ahead.until_us, ahead.sound_until_us, sequence, ahead.flies)
        self._blocks = (ahead.horizon, ahead.samples, ahead.cascade)

    def close(self) -> tuple[int, int] | None:
        """End them; returns time of the last and number of the next frame, None if there were none."""
        if self._blocks is None:
            return None
        self._blocks = None
        now_us, _, _, sequence, _ = self._moment[0].tolist()
        return None if now_us == self._opened_us else (now_us, sequence)

    @property
    def last_sensor(self) -> HilSensor:
        """What the last of them was of, until other bytes come."""
        payload = bytes(self.incoming[_PAYLOAD - _FIRST : _SENSOR_END - _FIRST])
        return HilSensor.from_payload(payload.ljust(_WHOLE_SENSOR_BYTES, b"\0"))

"""Actuator inbox: the vehicles' answers to their sensors, unpacked for all vehicles at once.

Nearly every answer is one valid frame of HIL_ACTUATOR_CONTROLS and nothing else. The received bytes lie in
rows of one array; one kernel checks and unpacks them. Anything else is left to a parser.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import FIRST, PAYLOAD, Octets, payload_bytes
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.mavlink.hil_schema import HIL_ACTUATOR_CONTROLS
from foundation.kernels.inner import constant
from foundation.types import Array
from netsim.wire.lockstep import BATCH_HANDED_OVER

BUFFER_BYTES = 250
"""Buffer of one vehicle; longer input is received in parts."""
ANSWER_BYTES = HIL_ACTUATOR_CONTROLS.frame_bytes
"""Length of a whole frame."""
_ANSWER, _PAYLOAD_BYTES = HIL_ACTUATOR_CONTROLS.dtype, HIL_ACTUATOR_CONTROLS.payload_bytes
_ANSWER_ID = constant(HIL_ACTUATOR_CONTROLS.message_id)
_ANSWER_EXTRA = constant(HIL_ACTUATOR_CONTROLS.crc_extra)
_ARMED = common.MAV_MODE_FLAG_SAFETY_ARMED
_CONTROLS = HIL_ACTUATOR_CONTROLS.dtype["controls"].shape[0]

CONNECTION_STATE = np.dtype(
    [
        ("received_bytes", "i8"),
        ("answered_us", "i8"),
        ("handed_over", "?"),
        ("needs_parser", "?"),
        ("newest_us", "i8"),
    ],
    align=True,
)
"""State of one vehicle's connection.

``received_bytes``: bytes in its buffer that are not processed yet. ``answered_us``: time stamp of its answer
in this step, 0 for none. ``handed_over``: that answer's flag of a batch for the radio. ``needs_parser``: a
parser reads the input, also if it is a single answer. ``newest_us``: time stamp of its last answer, 0 before
the first."""


def is_armed(answer: HilActuatorControls) -> bool:
    """Whether a vehicle's answer says that it is armed."""
    return bool(answer.mode & _ARMED)


class ActuatorInbox:
    """Answers of n vehicles in a step, and the motor controls of their last answers."""

    def __init__(self, vehicles: int, rotors: int = 4) -> None:
        """``rotors`` is the greatest number of rotors of a vehicle, R."""
        self.controls: Array = np.zeros((vehicles, rotors))
        """(n, R) of the last answer, 0..1 in the order of the airframe's rotors"""
        self.armed: NDArray[np.bool_] = np.zeros(vehicles, dtype=np.bool_)
        """(n,) of the last answer"""
        self.states = np.zeros(vehicles, CONNECTION_STATE)
        self.answered_us: NDArray[np.int64] = self.states["answered_us"]
        """(n,) time of the sensors that the answer in this step refers to; 0: there is none."""
        self._octets = np.zeros((vehicles, FIRST + BUFFER_BYTES), dtype=np.uint8)
        self.buffers = [memoryview(row)[FIRST:] for row in self._octets]  # type: ignore[arg-type]
        """Receive buffer of each vehicle; ``states["received_bytes"]`` is the length of its content."""

    @property
    def senders(self) -> tuple[int, ...]:
        """Vehicles that have handed over a batch to the radio in this step."""
        return tuple(np.flatnonzero(self.states["handed_over"]).tolist())

    def unpack(self, time_us: int) -> int:
        """Begin a step: unpack all answers that are exactly one frame; returns how many.

        The bytes of the other vehicles stay in their buffers.
        """
        return unpack(self._octets, self.states, time_us, self.controls, self.armed)

    def take_bytes(self, instance: int) -> bytes:
        """Return and clear the bytes of a vehicle that `unpack` left in its buffer."""
        received_bytes = int(self.states["received_bytes"][instance])
        self.states["received_bytes"][instance] = 0
        return bytes(self.buffers[instance][:received_bytes])

    def put(self, instance: int, answer: HilActuatorControls) -> None:
        """Store an answer that a parser unpacked."""
        self.controls[instance] = answer.controls[: self.controls.shape[1]]
        self.armed[instance] = is_armed(answer)
        state = self.states[instance]
        state["answered_us"] = state["newest_us"] = answer.time_usec
        state["handed_over"] = answer.flags & BATCH_HANDED_OVER != 0

    def newest(self, instance: int) -> HilActuatorControls | None:
        """Return the last answer of a vehicle, to any step, without its flags; None before the first."""
        newest_us = int(self.states["newest_us"][instance])
        if not newest_us:
            return None
        unused = (0.0,) * (_CONTROLS - self.controls.shape[1])
        controls = (*self.controls[instance].tolist(), *unused)
        return HilActuatorControls(newest_us, controls, _ARMED if self.armed[instance] else 0, 0)


@njit(cache=True)
def unpack(
    octets: Octets, states: NDArray[np.void], time_us: int, controls: Array, armed: NDArray[np.bool_]
) -> int:
    """Unpack the rows of ``octets`` (n, ...) that hold exactly one answer to the sensors of ``time_us``.

    Fills ``controls`` (n, R) and ``armed`` (n,), and updates ``states`` (n,) of `CONNECTION_STATE`; returns
    the number of rows unpacked.
    """
    unpacked = 0
    for i in range(len(states)):
        state, row = states[i], octets[i]
        state["answered_us"] = 0
        state["handed_over"] = False
        received_bytes = state["received_bytes"]
        if received_bytes != ANSWER_BYTES or state["needs_parser"]:
            continue
        if payload_bytes(row, received_bytes, _ANSWER_ID, _ANSWER_EXTRA) != _PAYLOAD_BYTES:
            continue
        answer = row[PAYLOAD : PAYLOAD + _PAYLOAD_BYTES].view(_ANSWER)[0]
        if np.int64(answer["time_usec"]) != time_us:
            continue
        for rotor in range(controls.shape[1]):
            controls[i, rotor] = answer["controls"][rotor]
        armed[i] = answer["mode"] & _ARMED != 0
        state["answered_us"] = time_us
        state["handed_over"] = np.int64(answer["flags"]) & BATCH_HANDED_OVER != 0
        state["received_bytes"] = 0
        state["newest_us"] = time_us
        unpacked += 1
    return unpacked

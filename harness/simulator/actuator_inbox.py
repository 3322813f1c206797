"""What the vehicles answer to their sensors, taken for all of them at once.

Nearly every answer is one right frame of HIL_ACTUATOR_CONTROLS and nothing else. The bytes of all lie in rows
of one array, and one kernel checks and unpacks them; what is anything else is left to a parser.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import CHECKSUM_BYTES, FIRST, HEADER_BYTES, Octets, payload_bytes
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.mavlink.hil_layout import (
    ACTUATORS_BYTES,
    ACTUATORS_CONTROLS,
    ACTUATORS_EXTRA,
    ACTUATORS_FLAGS,
    ACTUATORS_KIND,
    ACTUATORS_MODE,
    ACTUATORS_TIME,
)
from foundation.types import Array
from netsim.wire.lockstep import BATCH_HANDED_OVER

ROTORS = 4
ROOM_BYTES = 250
"""For what one vehicle says at once; a longer speech is heard in parts."""
ANSWER_BYTES = HEADER_BYTES + ACTUATORS_BYTES + CHECKSUM_BYTES
"""Length of a whole frame."""
_ARMED = common.MAV_MODE_FLAG_SAFETY_ARMED

VOICE = np.dtype(
    [("heard_bytes", "i8"), ("answered_us", "i8"), ("handed_over", "?"), ("by_hand", "?"), ("ever", "?")],
    align=True,
)
"""Of one vehicle: how much it has said that is not taken yet, the time of the answer that stands in this
step, 0 for none, whether that says that the radio was given something, whether a parser has to hear it in
every step, and whether it has ever answered."""


def is_armed(answer: HilActuatorControls) -> bool:
    """Whether a vehicle's answer says that it is armed."""
    return bool(answer.mode & _ARMED)


class ActuatorInbox:
    """What n vehicles have answered in a step, and the motors' controls from all steps up to it."""

    def __init__(self, vehicles: int) -> None:
        self.controls: Array = np.zeros((vehicles, ROTORS))
        """(n, 4) of the last answer, 0..1 in PX4's order"""
        self.armed: NDArray[np.bool_] = np.zeros(vehicles, dtype=np.bool_)
        """(n,) as the last answer says"""
        self.voices = np.zeros(vehicles, VOICE)
        self._octets = np.zeros((vehicles, FIRST + ROOM_BYTES), dtype=np.uint8)
        self.rooms = [memoryview(row)[FIRST:] for row in self._octets]  # type: ignore[arg-type]
        """Where to put what each vehicle says; ``voices["heard_bytes"]`` tells how much it was."""

    @property
    def answered_us(self) -> NDArray[np.int64]:
        """(n,) time of the sensors to which the answer in this step is; 0: there is none."""
        times_us: NDArray[np.int64] = self.voices["answered_us"]
        return times_us

    @property
    def senders(self) -> tuple[int, ...]:
        """Vehicles that have handed something over to the radio in this step."""
        return tuple(np.flatnonzero(self.voices["handed_over"]).tolist())

    def hear(self, instance: int, said: bytes) -> None:
        """Put down what a vehicle says, `ROOM_BYTES` at most."""
        self.rooms[instance][: len(said)] = said
        self.voices["heard_bytes"][instance] = len(said)

    def take(self, time_us: int) -> int:
        """Begin a step's answers with those that can be taken at once; returns how many.

        What the others have said is left where it is.
        """
        return take(self._octets, self.voices, time_us, self.controls, self.armed)

    def said(self, instance: int) -> bytes:
        """What a vehicle has said that could not be taken; it is regarded as taken from now on."""
        heard_bytes = int(self.voices["heard_bytes"][instance])
        self.voices["heard_bytes"][instance] = 0
        return bytes(self.rooms[instance][:heard_bytes])

    def put(self, instance: int, answer: HilActuatorControls) -> None:
        """Take an answer that was unpacked elsewhere."""
        self.controls[instance] = answer.controls[:ROTORS]
        self.armed[instance] = is_armed(answer)
        voice = self.voices[instance]
        voice["answered_us"], voice["ever"] = answer.time_usec, True
        voice["handed_over"] = answer.flags & BATCH_HANDED_OVER != 0


@njit(cache=True)
def take(
    octets: Octets, voices: NDArray[np.void], time_us: int, controls: Array, armed: NDArray[np.bool_]
) -> int:
    """Unpack the rows of ``octets`` (n, ...) that are an answer to the sensors of ``time_us`` and no more.

    Into ``controls`` (n, 4) and ``armed`` (n,), with notes in ``voices`` (n,) of `VOICE`; returns how many.
    """
    taken = 0
    for i in range(len(voices)):
        voice, row = voices[i], octets[i]
        voice["answered_us"] = 0
        voice["handed_over"] = False
        heard_bytes = voice["heard_bytes"]
        if heard_bytes != ANSWER_BYTES or voice["by_hand"]:
            continue
        if payload_bytes(row, heard_bytes, ACTUATORS_KIND, ACTUATORS_EXTRA) != ACTUATORS_BYTES:
            continue
        if row[ACTUATORS_TIME:ACTUATORS_FLAGS].view(np.int64)[0] != time_us:
            continue
        wanted = row[ACTUATORS_CONTROLS:ACTUATORS_MODE].view(np.float32)
        for rotor in range(ROTORS):
            controls[i, rotor] = wanted[rotor]
        armed[i] = row[ACTUATORS_MODE] & _ARMED != 0
        voice["answered_us"] = time_us
        flags = row[ACTUATORS_FLAGS:ACTUATORS_CONTROLS].view(np.int64)[0]
        voice["handed_over"] = flags & BATCH_HANDED_OVER != 0
        voice["heard_bytes"] = 0
        voice["ever"] = True
        taken += 1
    return taken

"""The beacon: position and velocity of a UAV at one time. No I/O."""

import math
import struct
from typing import NamedTuple

_FORMAT = struct.Struct("<2sBQ4f")
_MAGIC, _VERSION = b"RV", 1


class Beacon(NamedTuple):
    """Position (site NED) and velocity, horizontal, at ``time_us``."""

    time_us: int
    north_m: float
    east_m: float
    north_m_s: float
    east_m_s: float

    def encode(self) -> bytes:
        """Return its 27 bytes."""
        return _FORMAT.pack(_MAGIC, _VERSION, *self)

    def at(self, now_us: int) -> tuple[float, float]:
        """Return the position (north, east) at another time, if the velocity stays the same."""
        age_s = 1e-6 * (now_us - self.time_us)
        return self.north_m + age_s * self.north_m_s, self.east_m + age_s * self.east_m_s


def decode(payload: bytes) -> Beacon | None:
    """Return the beacon of a datagram; None for bytes that are none, or numbers that are not finite."""
    if len(payload) != _FORMAT.size:
        return None
    magic, version, time_us, *numbers = _FORMAT.unpack(payload)
    if (magic, version) != (_MAGIC, _VERSION) or not all(map(math.isfinite, numbers)):
        return None
    return Beacon(time_us, *numbers)

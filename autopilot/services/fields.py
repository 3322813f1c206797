"""Conversion of values to the ranges of MAVLink's fields, and the base class of telemetry."""

import math
from collections.abc import Iterable

from autopilot.mavlink.dialect import MESSAGE_IDS
from autopilot.services.flight_data import FlightData
from autopilot.services.streams import Builder

UNKNOWN_U16 = 65_535
UNKNOWN_I16 = 32_767
I8, I16, U16, I32 = (-128, 127), (-32_768, 32_767), (0, 65_535), (-(2**31), 2**31 - 1)
_FLOAT32_MAX = 3.402823e38


class Part:
    """Builds messages of one subject from a vehicle's current values; a builder returns None without data."""

    def __init__(self, flight: FlightData) -> None:
        self._flight = flight

    def boot_ms(self) -> int:
        """Time since the start in ms, wrapped to uint32."""
        return self._flight.now_us // 1000 % 2**32

    def make_builders(self) -> dict[int, Builder]:
        """Return the builders by message id: the methods that have the names of messages."""
        ids = {name: MESSAGE_IDS.get(name.upper()) for name in dir(self)}
        return {kind: getattr(self, name) for name, kind in ids.items() if kind is not None}


def place(lat_deg: float, lon_deg: float, alt_m: float) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees and altitude in mm, as MAVLink encodes positions."""
    return whole(lat_deg * 1e7, I32), whole(lon_deg * 1e7, I32), whole(alt_m * 1e3, I32)


def whole(value: float, limits: tuple[int, int]) -> int:
    """Nearest integer within ``limits``; 0 for NaN."""
    if math.isnan(value):
        return 0
    return round(min(max(value, limits[0]), limits[1]))


def singles(values: Iterable[float]) -> list[float]:
    """Clamp finite values to the range of float32; infinities and NaN are kept."""
    return [
        value if -_FLOAT32_MAX <= value <= _FLOAT32_MAX or not math.isfinite(value)
        else math.copysign(_FLOAT32_MAX, value)
        for value in values
    ]  # fmt: skip

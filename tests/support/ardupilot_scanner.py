"""Reader of states as ArduPilot's JSON backend reads them: by searching names in the text, not as JSON.

Written from the behaviour of libraries/SITL/SIM_JSON.cpp: the text between the last two line feeds is
searched from its begin for a section, from there for a key, and a value follows the key's quote and colon.
"""

import re
from dataclasses import dataclass, field

FIELDS = (
    ("", "timestamp", 1), ("", "latitude", 1), ("", "longitude", 1), ("", "altitude", 1),
    ("imu", "gyro", 3), ("imu", "accel_body", 3), ("", "position", 3), ("", "attitude", 3),
    ("", "quaternion", 4), ("", "velocity", 3),
    *(("", f"rng_{i}", 1) for i in range(1, 7)),
    ("", "velocity_wind", 3), ("windvane", "direction", 1), ("windvane", "speed", 1), ("", "airspeed", 1),
    ("", "no_time_sync", 1), ("", "no_lockstep", 1),
    *(("rc", f"rc_{i}", 1) for i in range(1, 13)),
    ("battery", "voltage", 1), ("battery", "current", 1),
)  # fmt: skip
"""Sections, keys, and the count of numbers."""
REQUIRED = {"timestamp", "gyro", "accel_body", "velocity"}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


class Rejected(ValueError):
    """A state without a mandatory field; ArduPilot ignores it, and its time stands still."""


def _number(text: str) -> float:
    """As strtod: the longest number at the begin, 0 without one."""
    match = _NUMBER.match(text)
    return float(match[0]) if match else 0.0


def _numbers(text: str, count: int) -> tuple[float, ...]:
    values = []
    for i in range(count):
        begin = re.search(r"[-0-9]", text)
        if begin is None:
            raise Rejected(f"{len(values)} of {count} numbers")
        text = text[begin.start() :]
        values.append(_number(text))
        end = re.search(r"[,\]]", text)
        text = text[end.start() :] if end else ""
        if i < count - 1:
            if not text.startswith(","):
                raise Rejected(f"no comma after {len(values)} of {count} numbers")
            text = text[1:]
    return tuple(values)


def scan(text: str) -> dict[str, tuple[float, ...]]:
    """Return the values of the fields in one line's text, by key. Raises Rejected."""
    found = {}
    for section, key, count in FIELDS:
        at = text.find(section)
        at = text.find(key, at + len(section) + 1) if at >= 0 else -1
        if at < 0:
            if key in REQUIRED:
                raise Rejected(f"no {section}/{key}")
            continue
        rest = text[at + len(key) + 2 :]
        found[key] = (_number(rest),) if count == 1 else _numbers(rest, count)
    if not {"attitude", "quaternion"} & found.keys():
        raise Rejected("no attitude")
    return found


@dataclass
class Receiver:
    """What ArduPilot keeps of the states: its buffer, its clock and the count of accepted states."""

    time_us: int = 0
    accepted: int = 0
    values: dict[str, tuple[float, ...]] = field(default_factory=dict)
    _buffer: str = ""
    _newest_s: float = 0.0

    def receive(self, datagram: bytes) -> bool:
        """Process a datagram; returns whether it was accepted, which advances the clock."""
        self._buffer += datagram.decode("ascii", "replace")
        ends = [at for at, letter in enumerate(self._buffer) if letter == "\n"]
        if len(ends) < 2:
            return False
        try:
            self.values = scan(self._buffer[ends[-2] + 1 : ends[-1]])
        except Rejected:
            return False
        self._buffer = self._buffer[ends[-1] :]
        self.advance(self.values["timestamp"][0])
        self.accepted += 1
        return True

    def advance(self, timestamp_s: float) -> None:
        """Add the difference to the previous time stamp, truncated to whole microseconds."""
        step_s = max(timestamp_s - self._newest_s, 0.0)
        self.time_us = int(float(self.time_us) + step_s * 1e6)
        self._newest_s = timestamp_s

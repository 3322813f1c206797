"""Messages of PX4's ULog format, version 1, as bytes.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html. A header, definitions (flag bits, formats,
information, parameters), then data: subscriptions, samples, changed parameters, texts. Pure.
"""

import math
import struct
from collections.abc import Mapping, Sequence

from autopilot.logs.ulog_topics import DATA, Topic

MAGIC = b"ULog\x01\x12\x35"
VERSION = 1
HEADER = struct.Struct("<7sBQ")
"""Of the file: magic, version, time of its begin in us."""
MESSAGE = struct.Struct("<HB")
"""Of a message: size of the content, kind."""
SYSTEM_DEFAULT = 1
"""Of a default parameter: PX4's default of the system, not of the airframe."""
Values = Mapping[str, float | Sequence[float]]
"""Values of a sample by field."""


def file_header(begin_us: int) -> bytes:
    """Return the header of a log that begins at a time, and its flag bits, of which none is set."""
    return HEADER.pack(MAGIC, VERSION, begin_us) + message("B", bytes(40))


def message(kind: str, content: bytes) -> bytes:
    """Return a message of a kind, one letter."""
    return MESSAGE.pack(len(content), ord(kind)) + content


def format_definition(topic: Topic) -> bytes:
    """Return the definition of a topic's samples."""
    return message("F", topic.format.encode())


def text_information(name: str, value: str) -> bytes:
    """Return information about the log as a text."""
    data = value.encode()
    return _keyed("I", f"char[{len(data)}] {name}", data)


def number_information(name: str, value: int) -> bytes:
    """Return information about the log as an unsigned number of 32 bits."""
    return _keyed("I", f"uint32_t {name}", struct.pack("<I", value))


def parameter(name: str, value: bytes, *, is_integer: bool) -> bytes:
    """Return the value of a parameter, four bytes, at the begin of the log or after a change."""
    return _keyed("P", f"{'int32_t' if is_integer else 'float'} {name}", value)


def default_parameter(name: str, value: bytes, *, is_integer: bool) -> bytes:
    """Return the default of a parameter, of the system."""
    key = f"{'int32_t' if is_integer else 'float'} {name}".encode()
    return message("Q", bytes([SYSTEM_DEFAULT, len(key)]) + key + value)


def subscription(number: int, topic: Topic) -> bytes:
    """Return the message that gives a topic the number that its samples have."""
    return message("A", struct.pack("<BH", 0, number) + topic.name.encode())


def logged_text(severity: int, now_us: int, text: str) -> bytes:
    """Return a text; ``severity`` is MAV_SEVERITY, as in syslog."""
    return message("L", struct.pack("<BQ", ord("0") + severity, now_us) + text.encode())


def _keyed(kind: str, key: str, value: bytes) -> bytes:
    return message(kind, bytes([len(key)]) + key.encode() + value)


class SampleEncoder:
    """Encodes samples of one topic: named values to a data message. Fields without a value are NaN or 0."""

    def __init__(self, number: int, topic: Topic) -> None:
        self._layout = topic.layout
        self._number, self._size = number, topic.size
        self._at: dict[str, int] = {}
        """Index of the first element of each field."""
        self._blank: list[float] = []
        for field in topic.fields:
            self._at[field.name] = len(self._blank)
            self._blank += [math.nan if field.kind in {"float", "double"} else 0] * (field.elements or 1)

    def encode(self, time_us: int, values: Values) -> bytes:
        """Return the message; empty if a value is beyond its type, as of an estimate that has diverged.

        Raises KeyError for a field that the topic does not have.
        """
        numbers = self._blank.copy()
        for name, value in values.items():
            at = self._at[name]
            if isinstance(value, Sequence):
                numbers[at : at + len(value)] = value
            else:
                numbers[at] = value
        try:
            return self._layout.pack(self._size, DATA, self._number, time_us, *numbers)
        except (OverflowError, struct.error):
            return b""

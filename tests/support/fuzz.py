"""Random and malformed input from a seed, together with the valid frames that it contains.

The environment variable COFLIGHT_FUZZ_BYTES is the number of bytes that the tests send to each port; its
default is 10 million.
"""

import hashlib
import os
from collections.abc import Iterator
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message

BYTES = int(os.environ.get("COFLIGHT_FUZZ_BYTES", "10_000_000"))
LARGEST_DATAGRAM = 65_507
"""Capacity of UDP over IPv4."""
_OTHER_SYSTEM = 77
_COMMANDS = np.array(sorted(common.enums["MAV_CMD"]))
_STATION = (255, 190)
_WITH_EFFECT = frozenset({common.MAVLINK_MSG_ID_HEARTBEAT})
"""Messages without a target that report the presence of their sender, so a valid one has an effect."""


class Datagram(NamedTuple):
    """Bytes, and the frames in them that a parser must find."""

    data: bytes
    frames: list[bytes]


def frame_of(
    kind: int, payload: bytes, *, version_1: bool = False, source: tuple[int, int] = _STATION
) -> bytes:
    """Return a frame with a right checksum and any payload."""
    made = common.mavlink_map[kind]
    sender = common.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
    message = common.MAVLink_message(kind, made.msgname)
    return bytes(message._pack(sender, made.crc_extra, payload, force_mavlink1=version_1))


def offset_of(kind: int, field: str) -> int | None:
    """Offset of a one-byte field in the payload; None if the message does not have it."""
    made = common.mavlink_map[kind]
    if field not in made.ordered_fieldnames:
        return None
    at = made.ordered_fieldnames.index(field)
    sizes = {"d": 8, "q": 8, "Q": 8, "f": 4, "i": 4, "I": 4, "h": 2, "H": 2, "b": 1, "B": 1, "c": 1}
    codes = bytes(made.native_format).decode().lstrip("<")
    counts = [max(1, n) for n in made.array_lengths]
    return sum(sizes[code] * count for code, count in list(zip(codes, counts, strict=True))[:at])


class Fuzz:
    """A source of random and malformed input, determined by its seed."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._kinds = sorted(kind for kind in common.mavlink_map if kind not in _WITH_EFFECT)
        self._for_others = [kind for kind in self._kinds if offset_of(kind, "target_system") is not None]
        self._makers = (
            self._random,
            self._beginnings,
            self._mutated,
            self._truncated,
            self._for_another,
            self._mixed,
        )

    def datagrams(self, count_bytes: int) -> Iterator[Datagram]:
        """Yield datagrams with a total of ``count_bytes``, without messages to a vehicle of the tests."""
        rng, sent = self._rng, 0
        while sent < count_bytes:
            datagram = self._makers[rng.integers(len(self._makers))]()
            sent += len(datagram.data)
            yield datagram

    def message_to(self, kind: int, *, system: int = 1) -> Message:
        """Return a message to a vehicle with any contents: random bytes, zeros, or all ones."""
        rng = self._rng
        size = common.mavlink_map[kind].unpacker.size
        style = rng.integers(4)
        payload = bytearray(rng.bytes(size) if style < 2 else bytes(size) if style == 2 else b"\xff" * size)
        for field, value in (("target_system", system), ("target", system), ("target_component", 1)):
            if (at := offset_of(kind, field)) is not None:
                payload[at] = value
        message = common.MAVLink(None).decode(bytearray(frame_of(kind, bytes(payload))))
        if hasattr(message, "command"):
            message.command = int(rng.choice(_COMMANDS))
        return message

    # ---- kinds of datagrams

    def _random(self) -> Datagram:
        size = LARGEST_DATAGRAM if self._rng.random() < 0.01 else self._rng.integers(0, 1_400)
        return Datagram(self._rng.bytes(int(size)), [])

    def _beginnings(self) -> Datagram:
        """Bytes with many apparent starts of frames."""
        data = self._rng.integers(0, 256, self._rng.integers(1, 700), dtype=np.uint8)
        data[self._rng.random(data.size) < 0.2] = 0xFD
        data[self._rng.random(data.size) < 0.2] = 0xFE
        data[self._rng.random(data.size) < 0.3] = 0
        return Datagram(data.tobytes(), [])

    def _whole(self) -> bytes:
        kind = int(self._rng.choice(self._kinds))
        version_1 = kind < 256 and self._rng.random() < 0.3
        payload = self._rng.bytes(common.mavlink_map[kind].unpacker.size)
        return frame_of(kind, payload, version_1=bool(version_1))

    def _mutated(self) -> Datagram:
        """Frames with a burst of up to 16 wrong bits, which a 16-bit checksum always detects."""
        rng, data = self._rng, bytearray()
        for _ in range(rng.integers(1, 6)):
            frame = bytearray(self._whole())
            at = int(rng.integers(1, len(frame) - 1))
            wrong = int(rng.integers(1, 1 << 16))
            frame[at] ^= wrong >> 8
            frame[at + 1] ^= wrong & 0xFF
            data += frame
        return Datagram(bytes(data), [])

    def _truncated(self) -> Datagram:
        frame = self._whole()
        return Datagram(frame[: self._rng.integers(len(frame))], [])

    def _for_another(self) -> Datagram:
        """Valid frames with random contents, for another vehicle."""
        frames = []
        for _ in range(self._rng.integers(1, 8)):
            kind = int(self._rng.choice(self._for_others))
            payload = bytearray(self._rng.bytes(common.mavlink_map[kind].unpacker.size))
            payload[offset_of(kind, "target_system") or 0] = _OTHER_SYSTEM
            frames.append(frame_of(kind, bytes(payload)))
        return Datagram(b"".join(frames), frames)

    def _mixed(self) -> Datagram:
        """Several of these kinds in one datagram."""
        makers = (self._random, self._beginnings, self._mutated, self._truncated, self._for_another)
        parts = [makers[i]() for i in self._rng.integers(0, len(makers), self._rng.integers(2, 5))]
        data = b"".join(part.data for part in parts)
        # beyond the capacity of a datagram data are cut off, and with them the ends of frames
        if len(data) > LARGEST_DATAGRAM:
            return Datagram(data[:LARGEST_DATAGRAM], [])
        return Datagram(data, [frame for part in parts for frame in part.frames])


def digest(thing: object, *, leave_out: frozenset[str] = frozenset()) -> str:
    """Hash of all state in an object, without the attributes in ``leave_out``.

    Code is not included.
    """
    hashed = hashlib.sha256()
    seen: dict[int, int] = {}
    kept: list[object] = []  # keeps ids unique

    def put(part: Any) -> None:
        if part is None or isinstance(part, (bool, int, float, complex, str, bytes, bytearray, np.generic)):
            hashed.update(f"{type(part).__name__}{part!r};".encode())
            return
        if isinstance(part, np.ndarray):
            hashed.update(f"array{part.shape}{part.dtype};".encode() + part.tobytes())
            return
        if isinstance(part, Enum):
            hashed.update(f"{part};".encode())
            return
        if callable(part) and not hasattr(part, "__dict__"):
            return
        if isinstance(part, (type, type(put), type(digest.__get__(0)))):
            return
        if id(part) in seen:
            hashed.update(f"again{seen[id(part)]};".encode())
            return
        seen[id(part)] = len(seen)
        kept.append(part)
        hashed.update(f"{type(part).__qualname__}(".encode())
        if isinstance(part, dict):
            for key, value in part.items():
                put(key)
                put(value)
        elif isinstance(part, (set, frozenset)):
            for entry in sorted(map(repr, part)):
                put(entry)
        elif isinstance(part, np.random.Generator):
            put(part.bit_generator.state)
        elif hasattr(part, "__iter__") and not hasattr(part, "__dict__") and not _slots(part):
            for entry in list(part):
                put(entry)
        for name in sorted({*getattr(part, "__dict__", {}), *_slots(part)} - leave_out):
            if hasattr(part, name):
                hashed.update(f"{name}=".encode())
                put(getattr(part, name))
        hashed.update(b")")

    put(thing)
    return hashed.hexdigest()


def _slots(thing: object) -> set[str]:
    fields = set(getattr(thing, "__struct_fields__", ()))
    for kind in type(thing).__mro__:
        slots = getattr(kind, "__slots__", ())
        fields |= {slots} if isinstance(slots, str) else set(slots)
    return {name for name in fields if not name.startswith("__")}

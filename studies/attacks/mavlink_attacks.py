"""Mutated MAVLink messages: all kinds of the dialect, with extreme and random contents. `frames` does no I/O.

Nothing is left out: also commands that reboot or terminate the vehicle, transfers of files and signing keys.
"""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect  # noqa: F401  # completes the dialect
from autopilot.mavlink.codec import Message
from studies.attacks.tasks import Address, MutatedMavlink, Report

SENDERS = ((255, 190), (1, 191), (1, 1), (2, 1), (0, 0))
"""Systems and components that the frames claim to come from."""
COMPONENTS = (0, 1, 1, 1, 191)
"""Components that they are sent to."""
SOCKETS = 3
_EXTREME_REALS = (float("nan"), float("inf"), float("-inf"), 3.4e38, -3.4e38, 1e-45, 0.0, -1.0, 1.0)
_BYTES = {"d": 8, "q": 8, "Q": 8, "f": 4, "i": 4, "I": 4, "h": 2, "H": 2, "b": 1, "B": 1, "c": 1}
_VERSION_1_KINDS = 256


def frames(system: int, rng: np.random.Generator) -> Iterator[bytes]:
    """Yield mutated frames, to a vehicle as far as a kind has a target: each kind, and all commands.

    Except for the last of each kind their checksums are right.
    """
    for kind in sorted(common.mavlink_map):
        extreme = _addressed(kind, _extreme_payload(kind, rng), system, rng)
        for payload in (
            _addressed(kind, rng.bytes(len(extreme)), system, rng),
            extreme,
            _flipped(extreme, rng),
            extreme[: int(rng.integers(len(extreme) + 1))],
        ):
            yield framed(kind, payload, rng)
        whole = framed(kind, extreme, rng)
        yield _flipped(whole, rng)
        yield whole[: int(rng.integers(len(whole)))]
    for command in sorted(common.enums["MAV_CMD"]):
        yield framed(common.MAVLINK_MSG_ID_COMMAND_LONG, _command_payload(command, system, rng), rng)
        values = [_real(rng) for _ in range(7)]
        made = common.MAVLink_command_int_message(
            system,
            1,
            int(rng.integers(8)),
            command & 0xFFFF,
            0,
            0,
            *values[:4],
            2**31 - 1,
            -(2**31),
            values[6],
        )
        yield framed(common.MAVLINK_MSG_ID_COMMAND_INT, _payload_of(made), rng)


def framed(kind: int, payload: bytes, rng: np.random.Generator) -> bytes:
    """Return a frame of version 1 or 2 with any payload and a right checksum."""
    made = common.mavlink_map[kind]
    system, component = SENDERS[int(rng.integers(len(SENDERS)))]
    sender = common.MAVLink(None, srcSystem=system, srcComponent=component)
    sender.seq = int(rng.integers(256))
    message = common.MAVLink_message(kind, made.msgname)
    version_1 = kind < _VERSION_1_KINDS and bool(rng.integers(2))
    return bytes(message._pack(sender, made.crc_extra, payload, force_mavlink1=version_1))


def _command_payload(command: int, system: int, rng: np.random.Generator) -> bytes:
    values = [_real(rng) for _ in range(7)]
    component = COMPONENTS[int(rng.integers(len(COMPONENTS)))]
    return struct.pack("<7fHBBB", *values, command & 0xFFFF, system, component, 0)


def _payload_of(message: Message) -> bytes:
    message.pack(common.MAVLink(None))
    return bytes(message.get_payload())


def _real(rng: np.random.Generator) -> float:
    return _EXTREME_REALS[int(rng.integers(len(_EXTREME_REALS)))]


def _fields(kind: int) -> Iterator[tuple[str, str, int, int]]:
    """Yield the fields of a kind in the order of its payload: name, type, offset, number of elements."""
    made, offset = common.mavlink_map[kind], 0
    codes = bytes(made.native_format).decode().lstrip("<")
    for name, code, length in zip(made.ordered_fieldnames, codes, made.array_lengths, strict=True):
        count = max(1, length)
        yield name, code, offset, count
        offset += _BYTES[code] * count


def _extreme_payload(kind: int, rng: np.random.Generator) -> bytes:
    """Return a payload whose numbers are extremes of their types: zeros, ones, not-a-number, infinity."""
    parts = []
    for _, code, _, count in _fields(kind):
        if code in "fd":
            parts.append(struct.pack(f"<{count}{code}", *(_real(rng) for _ in range(count))))
        else:
            size = _BYTES[code]
            largest, smallest = b"\xff" * (size - 1) + b"\x7f", b"\x00" * (size - 1) + b"\x80"
            choices = (bytes(size), b"\xff" * size, largest, smallest, b"\x01" + bytes(size - 1))
            parts += [choices[int(rng.integers(len(choices)))] for _ in range(count)]
    return b"".join(parts)


def _addressed(kind: int, payload: bytes, system: int, rng: np.random.Generator) -> bytes:
    """Return the payload with a vehicle as its target; one of five is to all systems."""
    changed = bytearray(payload)
    target = system if rng.integers(5) else 0
    component = COMPONENTS[int(rng.integers(len(COMPONENTS)))]
    for name, code, offset, _ in _fields(kind):
        if name in ("target_system", "target") and _BYTES[code] == 1:
            changed[offset] = target
        if name == "target_component":
            changed[offset] = component
    return bytes(changed)


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes with one to eight wrong bits."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if changed else 0):
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def send_mutated(task: MutatedMavlink, ended: threading.Event) -> Report:
    """Send all rounds to all ports at the rate; the addresses are those of the systems in turn, two each."""
    rng, sent = np.random.default_rng(task.seed), 0
    begin_s = time.monotonic()
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(_bound()) for _ in range(SOCKETS)]
        for _ in range(task.rounds):
            streams = [
                (address, frames(task.systems[place // 2], rng))
                for place, address in enumerate(task.datagrams_to)
            ]
            for column in zip(*(stream for _, stream in streams), strict=True):
                for (address, _), data in zip(streams, column, strict=True):
                    _send(sockets[sent % SOCKETS], data, address)
                sent += 1
                if ended.wait(max(0.0, begin_s + sent / task.frames_s - time.monotonic())):
                    break
    return Report(counts={"frames": sent * len(task.datagrams_to), "kinds": len(common.mavlink_map)})


def _bound() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.settimeout(0.0)
    return sock


def _send(sock: socket.socket, data: bytes, address: Address) -> None:
    with contextlib.suppress(OSError):  # of a vehicle that has ended
        sock.sendto(data, address)

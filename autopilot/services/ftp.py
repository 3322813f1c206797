"""MAVLink's file transfer, for reading: folders, files, checksums; bursts for speed.

A station opens a file in a session and chooses its number; sessions are kept per partner, so equal numbers do
not collide. All requests except those that end a session can be repeated safely; the answer to the latter is
stored and sent again on a repetition, as in PX4, because the first may have been lost.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.crc import crc32
from autopilot.services.files import FileStore, Readable
from autopilot.services.service import NEVER_US, Addressed, Partner, Service, reply
from autopilot.services.shaper import Room, always

DATA_BYTES = 239
MOST_SESSIONS = 8
IDLE_US = 10_000_000
"""Time without requests after which a session is closed."""
BURST_PERIOD_US = 4_000
BURST_PACKETS = 4
"""Packets of a burst per period: 240 kB/s."""
PACKETS_OF_BURST = 64
"""Length of a burst, after which the station requests the next."""
_CRC_PIECE_BYTES = 1 << 16
_HEADER = struct.Struct("<HBBBBBxI")
_SIZE = struct.Struct("<I")


class Opcode(IntEnum):
    """Opcodes of requests, and of the two kinds of answers."""

    NONE = 0
    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN_READ = 4
    READ = 5
    CREATE = 6
    WRITE = 7
    REMOVE = 8
    CREATE_FOLDER = 9
    REMOVE_FOLDER = 10
    OPEN_WRITE = 11
    TRUNCATE = 12
    RENAME = 13
    CHECKSUM = 14
    BURST = 15
    ACK = 128
    NAK = 129


class FtpFailure(IntEnum):
    """Reason of a refusal."""

    SIZE = 3
    SESSION = 4
    NO_SESSION_LEFT = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    PROTECTED = 9
    NOT_FOUND = 10


class FtpRequest(NamedTuple):
    """Header and data of a message's payload."""

    seq: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes

    @classmethod
    def parse(cls, payload: bytes) -> "FtpRequest":
        """Parse a payload of 251 bytes."""
        seq, session, opcode, size, _, _, offset = _HEADER.unpack_from(payload)
        return cls(seq, session, opcode, size, offset, payload[_HEADER.size : _HEADER.size + size])

    @property
    def path(self) -> str:
        """The data, decoded as a path."""
        return self.data.split(b"\0", 1)[0].decode("utf-8", "replace")

    @property
    def read_bytes(self) -> int:
        """Bytes that a read requests: DATA_BYTES if the size is 0."""
        return self.size or DATA_BYTES


class _Burst(NamedTuple):
    seq: int
    offset: int
    packet_bytes: int
    packets: int


class _Session:
    def __init__(self, file: Readable, target: tuple[int, int]) -> None:
        self.file = file
        self.target = target
        self.used_us = 0
        self.burst: _Burst | None = None


_Key = tuple[Partner, int]
_Answer = bytes | FtpFailure
"""Data of an ACK, or the reason of a NAK."""


class FtpService(Service):
    """The server for the files of a `FileStore`."""

    def __init__(
        self, files: FileStore, on_open: Callable[[str, Partner], None] | None = None, has_room: Room = always
    ) -> None:
        """``on_open`` is called with each opened path and the partner."""
        super().__init__(FILE_TRANSFER_PROTOCOL=self._on_request)
        self._files = files
        self._has_room = has_room
        self._on_open = on_open
        self._sessions: dict[_Key, _Session] = {}
        self._ended: dict[Partner, tuple[bytes, Message, int]] = {}
        """The last request of each partner that ended a session, its answer, and its time."""

    def _on_request(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request; a burst is sent by `on_timer`."""
        payload = bytes(message.payload)
        request = FtpRequest.parse(payload)
        if request.opcode >= Opcode.ACK:
            return ()  # an answer, not a request
        self._forget_idle(now_us)
        ended = self._ended.get(partner)
        if ended is not None and ended[0] == payload:
            return reply(partner, ended[1])
        target = (message.get_srcSystem(), message.get_srcComponent())
        answer = self._answer(request, partner, target, now_us)
        if answer is None:
            return ()
        formed = _formed(request, answer, target)
        if request.opcode in {Opcode.TERMINATE, Opcode.RESET}:
            self._ended[partner] = payload, formed, now_us
            if len(self._ended) > MOST_SESSIONS:
                del self._ended[next(iter(self._ended))]
        return reply(partner, formed)

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Send the next packets of the bursts."""
        if now_us < self.due_us:
            return ()
        messages: list[Addressed] = []
        for (partner, number), session in self._sessions.items():
            if session.burst is None:
                continue
            session.used_us = now_us
            if self._has_room(partner):
                messages += reply(partner, *_next_packets(number, session))
        bursting = any(session.burst is not None for session in self._sessions.values())
        self.due_us = now_us + BURST_PERIOD_US if bursting else NEVER_US
        return messages

    def _answer(
        self, request: FtpRequest, partner: Partner, target: tuple[int, int], now_us: int
    ) -> _Answer | None:
        """Execute a request and return its answer; None for a burst, which begins."""
        key = partner, request.session
        session = self._sessions.get(key)
        answer: _Answer | None = FtpFailure.UNKNOWN_COMMAND
        if request.size > DATA_BYTES:
            return FtpFailure.SIZE
        match request.opcode:
            case Opcode.NONE:
                answer = b""
            case Opcode.LIST:
                answer = self._list(request)
            case Opcode.OPEN_READ:
                answer = self._open(request, partner, target, now_us)
            case Opcode.CHECKSUM:
                answer = self._checksum(request)
            case Opcode.RESET:
                for other in [other for other in self._sessions if other[0] == partner]:
                    del self._sessions[other]
                answer = b""
            case Opcode.READ | Opcode.BURST | Opcode.TERMINATE if session is None:
                answer = FtpFailure.SESSION
            case Opcode.READ if session is not None:
                session.used_us = now_us
                answer = session.file.read(request.offset, request.read_bytes) or FtpFailure.END_OF_FILE
            case Opcode.BURST if session is not None:
                answer = self._begin_burst(request, session, now_us)
            case Opcode.TERMINATE:
                del self._sessions[key]
                answer = b""
            case opcode if Opcode.CREATE <= opcode <= Opcode.RENAME:  # those that write
                answer = FtpFailure.PROTECTED
        return answer

    def _open(self, request: FtpRequest, partner: Partner, target: tuple[int, int], now_us: int) -> _Answer:
        """Open a session; an open one of the same number is replaced."""
        key = partner, request.session
        if key not in self._sessions and len(self._sessions) >= MOST_SESSIONS:
            return FtpFailure.NO_SESSION_LEFT
        file = self._files.open(request.path)
        if file is None:
            return FtpFailure.NOT_FOUND
        session = self._sessions[key] = _Session(file, target)
        session.used_us = now_us
        if self._on_open is not None:
            self._on_open(request.path, partner)
        return _SIZE.pack(file.size())

    def _list(self, request: FtpRequest) -> _Answer:
        """Entries from the requested index on, as many as fit."""
        entries = self._files.list(request.path)
        if entries is None:
            return FtpFailure.NOT_FOUND
        data = b""
        for name, size in entries[request.offset :]:
            text = f"D{name}" if size is None else f"F{name}\t{size}"
            entry = text.encode() + b"\0"
            if len(data) + len(entry) > DATA_BYTES:
                break
            data += entry
        return FtpFailure.END_OF_FILE if request.offset and not data else data

    def _checksum(self, request: FtpRequest) -> _Answer:
        file = self._files.open(request.path)
        if file is None:
            return FtpFailure.NOT_FOUND
        checksum, offset = 0, 0
        while piece := file.read(offset, _CRC_PIECE_BYTES):
            checksum = crc32(piece, checksum)
            offset += len(piece)
        return _SIZE.pack(checksum)

    def _begin_burst(self, request: FtpRequest, session: _Session, now_us: int) -> _Answer | None:
        session.used_us = now_us
        if request.offset >= session.file.size():
            session.burst = None
            return FtpFailure.END_OF_FILE
        session.burst = _Burst(request.seq + 1, request.offset, request.read_bytes, PACKETS_OF_BURST)
        self.due_us = min(self.due_us, now_us)
        return None

    def _forget_idle(self, now_us: int) -> None:
        idle = [key for key, session in self._sessions.items() if now_us - session.used_us > IDLE_US]
        for key in idle:
            del self._sessions[key]
        self._ended = {
            partner: ended for partner, ended in self._ended.items() if now_us - ended[2] <= IDLE_US
        }


def _next_packets(number: int, session: _Session) -> Iterator[Message]:
    """Packets of a session's burst for one period; the last of the burst is marked as such."""
    for _ in range(BURST_PACKETS):
        burst = session.burst
        if burst is None:
            return
        data = session.file.read(burst.offset, burst.packet_bytes)
        offset, left = burst.offset + len(data), burst.packets - 1
        complete = left == 0 or offset >= session.file.size() or not data
        session.burst = None if complete else _Burst(burst.seq + 1, offset, burst.packet_bytes, left)
        header = (burst.seq % 65_536, number, Opcode.ACK, len(data), Opcode.BURST, complete, burst.offset)
        yield _message(header, data, session.target)


def _formed(request: FtpRequest, answer: _Answer, target: tuple[int, int]) -> Message:
    """Answer to a request: an ACK with data or a NAK with the reason, and the request's numbers."""
    opcode, data = (Opcode.ACK, answer) if isinstance(answer, bytes) else (Opcode.NAK, bytes([answer]))
    seq = (request.seq + 1) % 65_536
    return _message(
        (seq, request.session, opcode, len(data), request.opcode, 0, request.offset), data, target
    )


def _message(header: tuple[int, ...], data: bytes, target: tuple[int, int]) -> Message:
    payload = (_HEADER.pack(*header) + data).ljust(_HEADER.size + DATA_BYTES, b"\0")
    return common.MAVLink_file_transfer_protocol_message(0, *target, payload)

"""Framing of MAVLink 1 and 2 messages, in pymavlink's ``common`` dialect.

pymavlink packs and unpacks the messages. The framing is done here, because its own parser discards a whole
frame's length after one wrong byte and has no notion of the end of a datagram. Input is untrusted: nothing
raises.
"""

import re
from struct import Struct
from typing import TypeAlias

from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect  # noqa: F401  # completes the dialect before anything is parsed
from autopilot.mavlink.counters import Counters
from autopilot.mavlink.signing import INCOMPAT_SIGNED, SIGNATURE_BYTES, SignatureVerdict, Signer

Message: TypeAlias = common.MAVLink_message

_MAGIC = re.compile(rb"[\xfd\xfe]")
_MAGIC_V1, _MAGIC_V2 = 0xFE, 0xFD
_HEADER_BYTES = {_MAGIC_V1: 6, _MAGIC_V2: 10}
_CHECKSUM = Struct("<H")
_FIRST_CHECKED = 1
_FLAGS, _SEQUENCE, _COMPONENT, _KIND = 2, 4, 6, 7
"""Offsets in a frame of MAVLink 2."""
_KIND_V1 = 5
_SIZING = common.MAVLink(None)
_CRC_EXTRA = {kind: bytes([made.crc_extra]) for kind, made in common.mavlink_map.items()}


class Parser:
    """Parses bytes into messages.

    After bytes that are no message the search resumes at the next byte, so a broken frame never hides a
    complete one. A frame of an unknown message is skipped whole if frames fill its datagram from the begin to
    its end, or to the next frame: its payload is no message. With a signer only messages signed with its key
    are returned.

    Attributes:
        looked_at: number of apparent frames so far, right and wrong. Work is proportional to it: a wrong
            one costs a checksum over at most 280 bytes, a right one its unpacking.
    """

    def __init__(self, signer: Signer | None = None) -> None:
        self.counters = Counters()
        self.looked_at = 0
        self._signer = signer
        self._buffer = bytearray()
        self._mavlink = common.MAVLink(None)

    @property
    def bad_bytes(self) -> int:
        """Count of bytes that belonged to no message of the dialect with a right checksum."""
        return self.counters.bytes_bad

    def push(self, data: bytes) -> list[Message]:
        """Messages that are complete after the next ``data`` of a byte stream."""
        return self.push_piece(data)

    def push_piece(self, data: bytes, now: int = 0) -> list[Message]:
        """Messages that are complete after the next ``data`` of a byte stream; ``now`` as `push_datagram`."""
        self._buffer += data
        return self._parse(ended=False, now=now)

    def push_datagram(self, data: bytes, now: int = 0) -> list[Message]:
        """Messages in a datagram; a frame that does not end in it is bad.

        ``now`` is the wall clock in units of signatures, for the signer.
        """
        self._buffer[:] = data
        return self._parse(ended=True, now=now)

    def _parse(self, *, ended: bool, now: int) -> list[Message]:
        buffer = self._buffer
        counters = self.counters
        messages: list[Message] = []
        at = 0
        framed = ended
        """Whether frames fill the datagram up to here."""
        while (magic := _MAGIC.search(buffer, at)) is not None:
            if magic.start() > at:
                counters.bytes_bad += magic.start() - at
                at, framed = magic.start(), False
            self.looked_at += 1
            length = _frame_bytes(buffer, at)
            if length is None or len(buffer) - at < length:
                if not ended:
                    break
            elif self._is_right(buffer, at, at + length):
                frame = buffer[at : at + length]
                message = self._decode(frame)
                if message is not None:
                    if self._is_trusted(frame, now):
                        messages.append(message)
                    at += length
                    continue
            elif framed and self._is_unknown(buffer, at, at + length):
                counters.bytes_unknown += length
                at += length
                continue
            counters.bytes_bad += 1
            at, framed = at + 1, False
        else:
            counters.bytes_bad += len(buffer) - at
            at = len(buffer)
        del buffer[:at]
        return messages

    def _is_right(self, buffer: bytearray, begin: int, end: int) -> bool:
        """Whether a complete frame is in the dialect, has a right checksum, and may be parsed."""
        if buffer[begin] == _MAGIC_V1:
            kind = buffer[begin + _KIND_V1]
        else:
            flags = buffer[begin + _FLAGS]
            if flags & ~INCOMPAT_SIGNED:
                # an unknown incompatibility flag: the frame must not be parsed
                self.counters.frames_incompatible += 1
                return False
            kind = int.from_bytes(buffer[begin + _KIND : begin + _HEADER_BYTES[_MAGIC_V2]], "little")
            if flags:
                end -= SIGNATURE_BYTES
        crc_extra = _CRC_EXTRA.get(kind)
        if crc_extra is None:
            self.counters.frames_unknown += 1
            return False
        end -= _CHECKSUM.size
        checksum = crc16.mcrf4xx(bytes(buffer[begin + _FIRST_CHECKED : end] + crc_extra))
        if (checksum,) != _CHECKSUM.unpack_from(buffer, end):
            self.counters.frames_bad_checksum += 1
            return False
        return True

    @staticmethod
    def _is_unknown(buffer: bytearray, begin: int, end: int) -> bool:
        """Whether a frame of MAVLink 2 is of an unknown message and followed by a frame or the end."""
        if buffer[begin] != _MAGIC_V2 or buffer[begin + _FLAGS] & ~INCOMPAT_SIGNED:
            return False
        kind = int.from_bytes(buffer[begin + _KIND : begin + _HEADER_BYTES[_MAGIC_V2]], "little")
        return kind not in _CRC_EXTRA and (end == len(buffer) or buffer[end] in (_MAGIC_V1, _MAGIC_V2))

    def _decode(self, frame: bytearray) -> Message | None:
        try:
            return self._mavlink.decode(frame)
        except common.MAVError:
            return None

    def _is_trusted(self, frame: bytearray, now: int) -> bool:
        if self._signer is None:
            return True
        verdict = self._signer.judge(frame, now)
        if verdict is SignatureVerdict.GOOD:
            return True
        counters = self.counters
        if verdict is SignatureVerdict.UNSIGNED:
            counters.unsigned += 1
        elif verdict is SignatureVerdict.BAD:
            counters.signature_bad += 1
        else:
            counters.replayed += 1
        return False


class Encoder:
    """Packs messages as MAVLink 2 for one link, which has its own sequence numbers."""

    def __init__(self, *, system: int, component: int) -> None:
        self._mavlink = common.MAVLink(None)
        self._own = (system, component)

    def encode(self, message: Message) -> bytes:
        """Pack a message; one with a source (see `stamp`) keeps it, as required for forwarded messages."""
        link = self._mavlink
        source = (message.get_srcSystem(), message.get_srcComponent())
        link.srcSystem, link.srcComponent = source if source[0] else self._own
        frame: bytes = message.pack(link)
        link.seq = (link.seq + 1) % 256
        return frame

    def encode_for(self, message: Message, sequences: "Sequences") -> bytes:
        """Pack a message with the next sequence number of a partner."""
        header, link = message.get_header(), self._mavlink
        own_system, own_component = self._own
        link.srcSystem = header.srcSystem or own_system
        link.srcComponent = component = header.srcComponent if header.srcSystem else own_component
        link.seq = sequences.take(component)
        frame: bytes = message.pack(link)
        return frame


class Sequences:
    """The sequence numbers of the frames that are sent to one partner.

    Each source has its own count, as receivers expect, of frames to this partner only: a gap is a loss.
    """

    def __init__(self) -> None:
        self._next: dict[int, int] = {}
        """By component; all are of one system."""

    def take(self, component: int) -> int:
        """Return a component's next number and advance it."""
        sequence = self._next.get(component, 0)
        self._next[component] = (sequence + 1) & 0xFF
        return sequence

    def renumber(self, frame: bytes, kind: int) -> bytes:
        """Give a MAVLink 2 frame that was packed for another partner the next number of this one."""
        sequence = self.take(frame[_COMPONENT])
        return frame if frame[_SEQUENCE] == sequence else _resealed(frame, kind, 0, sequence)


def signed(frame: bytes, kind: int, signer: Signer, now: int) -> bytes:
    """Sign an unsigned frame of MAVLink 2 at wall time ``now``; see `signing`."""
    return signer.sign(_resealed(frame, kind, INCOMPAT_SIGNED, frame[_SEQUENCE]), now)


def stamp(message: Message, *, system: int, component: int) -> Message:
    """Write the source into a message that is passed on without being packed, and return it."""
    header = message.get_header()
    header.srcSystem, header.srcComponent = system, component
    return message


def kind_of(frame: bytes) -> int:
    """Return the message id of a whole frame."""
    if frame[0] == _MAGIC_V1:
        return frame[_KIND_V1]
    return int.from_bytes(frame[_KIND : _HEADER_BYTES[_MAGIC_V2]], "little")


def frame_bytes(message: Message) -> int:
    """Length of a message's unsigned MAVLink 2 frame in bytes."""
    header = message.get_header()
    # packing overwrites them
    _SIZING.srcSystem, _SIZING.srcComponent = header.srcSystem, header.srcComponent
    frame: bytes = message.pack(_SIZING)
    return len(frame)


def _resealed(frame: bytes, kind: int, flags: int, sequence: int) -> bytes:
    """Frame with other flags and sequence number, and the matching checksum."""
    changed = bytearray(frame)
    changed[_FLAGS], changed[_SEQUENCE] = flags, sequence
    end = len(changed) - _CHECKSUM.size
    checksum = crc16.mcrf4xx(bytes(changed[_FIRST_CHECKED:end]) + _CRC_EXTRA[kind])
    _CHECKSUM.pack_into(changed, end, checksum)
    return bytes(changed)


def _frame_bytes(buffer: bytearray, at: int) -> int | None:
    """Length of the frame that begins at ``at``, or None if its header is incomplete."""
    magic = buffer[at]
    header_bytes = _HEADER_BYTES[magic]
    if len(buffer) - at < header_bytes:
        return None
    signed = magic != _MAGIC_V1 and buffer[at + 2] & INCOMPAT_SIGNED
    return header_bytes + buffer[at + 1] + _CHECKSUM.size + (SIGNATURE_BYTES if signed else 0)

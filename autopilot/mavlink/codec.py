"""Bytes to MAVLink messages and back, for both versions of the protocol, in pymavlink's ``common`` dialect.

pymavlink packs and unpacks the messages. The framing is done here, because its own parser throws away a
whole frame's length after one wrong byte and cannot be told that a datagram has ended. Input is hostile:
nothing raises.
"""

import re
from typing import TypeAlias

from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect  # noqa: F401  # completes the dialect: without it nobody should parse

Message: TypeAlias = common.MAVLink_message

_MAGIC = re.compile(rb"[\xfd\xfe]")
_MAGIC_V1 = 0xFE
_HEADER_BYTES = {0xFE: 6, 0xFD: 10}
_CHECKSUM_BYTES = 2
_SIGNATURE_BYTES = 13
_INCOMPAT_SIGNED = 0x01


class Parser:
    """Takes bytes as they come and returns the messages in them.

    After bytes that are no message it searches on from the next, so a broken frame never hides a whole one.
    """

    def __init__(self) -> None:
        self.bad_bytes = 0
        """Bytes that belonged to no message of the dialect with a right checksum."""
        self._buffer = bytearray()
        self._mavlink = common.MAVLink(None)

    def push(self, data: bytes) -> list[Message]:
        """Messages that are complete after the next ``data`` of a byte stream."""
        self._buffer += data
        return self._parse(ended=False)

    def push_datagram(self, data: bytes) -> list[Message]:
        """Messages in a datagram; a frame that does not end in it is bad."""
        self._buffer[:] = data
        return self._parse(ended=True)

    def _parse(self, *, ended: bool) -> list[Message]:
        buffer = self._buffer
        messages: list[Message] = []
        at = 0
        while (magic := _MAGIC.search(buffer, at)) is not None:
            self.bad_bytes += magic.start() - at
            at = magic.start()
            length = _frame_bytes(buffer, at)
            if length is None or len(buffer) - at < length:
                if not ended:
                    break
            elif (message := self._decode(buffer[at : at + length])) is not None:
                messages.append(message)
                at += length
                continue
            self.bad_bytes += 1
            at += 1
        else:
            self.bad_bytes += len(buffer) - at
            at = len(buffer)
        del buffer[:at]
        return messages

    def _decode(self, frame: bytearray) -> Message | None:
        if frame[0] != _MAGIC_V1 and frame[2] & ~_INCOMPAT_SIGNED:
            return None  # the sender says that whoever does not know the flag must not read on
        try:
            message = self._mavlink.decode(frame)
        except common.MAVError:
            return None
        return None if isinstance(message, common.MAVLink_unknown) else message


class Encoder:
    """Packs messages as MAVLink 2 for one link, which has its own sequence numbers."""

    def __init__(self, *, system: int, component: int) -> None:
        self._mavlink = common.MAVLink(None)
        self._own = (system, component)

    def encode(self, message: Message) -> bytes:
        """Pack a message; one that carries a source (see `stamp`) keeps it, as forwarded messages must."""
        link = self._mavlink
        source = (message.get_srcSystem(), message.get_srcComponent())
        link.srcSystem, link.srcComponent = source if source[0] else self._own
        frame: bytes = message.pack(link)
        link.seq = (link.seq + 1) % 256
        return frame


def stamp(message: Message, *, system: int, component: int) -> Message:
    """Write the source into a message that is handed over without being packed, and return it."""
    header = message.get_header()
    header.srcSystem, header.srcComponent = system, component
    return message


def _frame_bytes(buffer: bytearray, at: int) -> int | None:
    """Length of the frame that begins at ``at``, or None while its header is not there."""
    magic = buffer[at]
    header_bytes = _HEADER_BYTES[magic]
    if len(buffer) - at < header_bytes:
        return None
    signed = magic != _MAGIC_V1 and buffer[at + 2] & _INCOMPAT_SIGNED
    return header_bytes + buffer[at + 1] + _CHECKSUM_BYTES + (_SIGNATURE_BYTES if signed else 0)

"""The time master's line to the emulator: one stream socket, an interval asked for, an interval done.

Made by whoever starts the two processes and inherited by both, so nobody else can be at either end, and the
end of one process is an end of file at the other at once.
"""

import contextlib
import socket
import struct
from typing import Generic, TypeVar

import msgspec

from netsim.wire.lockstep import Advance, Advanced

ADVANCE_LIMIT_S = 20.0
"""Wall time that the emulator has for one interval; far beyond what a loaded machine needs."""
BATCH_LIMIT_S = 0.25
"""Wall time that the emulator waits for a vehicle's batch before the time master is asked about it."""
_HEADER = struct.Struct("<I")
"""Length of the message that follows."""
_RECEIVE_BYTES = 65_536
_encoder = msgspec.msgpack.Encoder()

SentT = TypeVar("SentT", Advance, Advanced)
HeardT = TypeVar("HeardT", Advance, Advanced)


class IntervalStream(Generic[SentT, HeardT]):
    """One end of the line; close it. For one thread."""

    def __init__(self, connection: socket.socket, heard: type[HeardT], *, limit_s: float | None) -> None:
        self._connection = connection
        self._decoder: msgspec.msgpack.Decoder[HeardT] = msgspec.msgpack.Decoder(heard)
        self._rest = b""
        if limit_s is not None:
            # the kernel's time limit, for Python's own costs a system call more each time
            whole_s = int(limit_s)
            timeval = struct.pack("ll", whole_s, round((limit_s - whole_s) * 1e6))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)

    def send(self, message: SentT) -> None:
        """Send a message; that nobody is at the other end any more is what `receive` tells."""
        body = _encoder.encode(message)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self._connection.sendall(_HEADER.pack(len(body)) + body)

    def receive(self) -> HeardT | None:
        """Next message, None if the other end has hung up.

        Raises TimeoutError when it takes too long, and msgspec.DecodeError for what is no message.
        """
        data = self._rest
        while len(data) < _HEADER.size or len(data) < (end := _HEADER.size + _HEADER.unpack_from(data)[0]):
            try:
                more = self._connection.recv(_RECEIVE_BYTES)
            except BlockingIOError:
                self._rest = data
                raise TimeoutError from None
            except ConnectionResetError:
                more = b""
            if not more:
                return None
            data += more
        self._rest = data[end:]
        return self._decoder.decode(data[_HEADER.size : end])

    def close(self) -> None:
        """Hang up; harmless when repeated."""
        self._connection.close()


def time_masters_end(connection: socket.socket) -> IntervalStream[Advance, Advanced]:
    """The end that asks."""
    return IntervalStream(connection, Advanced, limit_s=ADVANCE_LIMIT_S)


def emulators_end(connection: socket.socket) -> IntervalStream[Advanced, Advance]:
    """The end that simulates; it waits as long as the run does."""
    return IntervalStream(connection, Advance, limit_s=None)

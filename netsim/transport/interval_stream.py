"""Stream socket between time master and emulator: requests for intervals, and their replies.

It is created by the parent of the two processes and inherited by both, so no other process can connect, and
the exit of one process is an end of file at the other.
"""

import contextlib
import socket
import struct
from typing import Generic, TypeVar

import msgspec

from netsim.wire.lockstep import Advance, Advanced

ADVANCE_LIMIT_S = 20.0
"""Time-out of one interval, wall time; far above the need of a loaded machine."""
BATCH_LIMIT_S = 0.25
"""Wall time that the emulator waits for a vehicle's batch before it reports it missing."""
_HEADER = struct.Struct("<I")
"""Length of the following message."""
_RECEIVE_BYTES = 65_536
_encoder = msgspec.msgpack.Encoder()

SentT = TypeVar("SentT", Advance, Advanced)
ReceivedT = TypeVar("ReceivedT", Advance, Advanced)


class IntervalStream(Generic[SentT, ReceivedT]):
    """One end of the stream, for one thread; the caller closes the connection."""

    def __init__(
        self, connection: socket.socket, received: type[ReceivedT], *, limit_s: float | None
    ) -> None:
        self._connection = connection
        self._decoder: msgspec.msgpack.Decoder[ReceivedT] = msgspec.msgpack.Decoder(received)
        self._rest = b""
        if limit_s is not None:
            # a time-out of the kernel: Python's own costs one more system call per receive
            whole_s = int(limit_s)
            timeval = struct.pack("ll", whole_s, round((limit_s - whole_s) * 1e6))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)

    def send(self, message: SentT) -> None:
        """Send a message; a closed connection is ignored here and reported by `receive`."""
        body = _encoder.encode(message)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self._connection.sendall(_HEADER.pack(len(body)) + body)

    def receive(self) -> ReceivedT | None:
        """Return the next message, or None if the connection is closed.

        Raises TimeoutError after the time-out, and msgspec.DecodeError for an invalid message.
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


def time_masters_end(connection: socket.socket) -> IntervalStream[Advance, Advanced]:
    """Return the stream of the time master, which requests intervals."""
    return IntervalStream(connection, Advanced, limit_s=ADVANCE_LIMIT_S)


def emulators_end(connection: socket.socket) -> IntervalStream[Advanced, Advance]:
    """Return the stream of the emulator, which waits for requests without a time-out."""
    return IntervalStream(connection, Advance, limit_s=None)

"""Stream socket between two processes of a run that carries typed messages.

It is created by the parent of the two processes and inherited by both, so no other process can connect, and
the exit of one process is an end of file at the other. A message is its length and its MessagePack encoding.
"""

import contextlib
import socket
import struct
from typing import Generic, TypeVar

import msgspec

_HEADER = struct.Struct("<I")
"""Length of the following message."""
_RECEIVE_BYTES = 65_536
_encoder = msgspec.msgpack.Encoder()

SentT = TypeVar("SentT", bound=msgspec.Struct)
ReceivedT = TypeVar("ReceivedT", bound=msgspec.Struct)


class MessageStream(Generic[SentT, ReceivedT]):
    """One end of the stream, for one thread; the caller closes the connection.

    ``limit_s`` is the time-out of `receive`, wall time; None: no time-out.
    """

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

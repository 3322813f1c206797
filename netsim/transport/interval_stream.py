"""Stream between time master and emulator: requests for intervals, and their replies."""

import socket

from foundation.processes.message_stream import MessageStream
from netsim.wire.lockstep import Advance, Advanced

ADVANCE_LIMIT_S = 20.0
"""Time-out of one interval, wall time, of a time master that does not watch the emulator's process."""
BATCH_LIMIT_S = 0.25
"""Wall time that the emulator waits for a vehicle's batch before it reports it missing."""


def time_masters_end(
    connection: socket.socket, *, limit_s: float = ADVANCE_LIMIT_S
) -> MessageStream[Advance, Advanced]:
    """Return the stream of the time master, which requests intervals, with a time-out of its `receive`."""
    return MessageStream(connection, Advanced, limit_s=limit_s)


def emulators_end(connection: socket.socket) -> MessageStream[Advanced, Advance]:
    """Return the stream of the emulator, which waits for requests without a time-out."""
    return MessageStream(connection, Advance, limit_s=None)

"""Stream between time master and emulator: requests for intervals, and their replies."""

import socket

from foundation.processes.message_stream import MessageStream
from netsim.wire.lockstep import Advance, Advanced

ADVANCE_LIMIT_S = 20.0
"""Time-out of one interval, wall time; far above the need of a loaded machine."""
BATCH_LIMIT_S = 0.25
"""Wall time that the emulator waits for a vehicle's batch before it reports it missing."""


def time_masters_end(connection: socket.socket) -> MessageStream[Advance, Advanced]:
    """Return the stream of the time master, which requests intervals."""
    return MessageStream(connection, Advanced, limit_s=ADVANCE_LIMIT_S)


def emulators_end(connection: socket.socket) -> MessageStream[Advanced, Advance]:
    """Return the stream of the emulator, which waits for requests without a time-out."""
    return MessageStream(connection, Advance, limit_s=None)

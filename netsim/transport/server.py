"""The 802.11 emulator's process: Zenoh and the time master's line in front, the emulator behind.

One thread takes an interval from the time master, what the vehicles have sent for it, simulates and sends
what arrived. Vehicles send one way and nothing of Python's runs when they do; the time master says whose
batches there are, and they are waited for. What belongs to later steps stays, so the air does not depend on
which of two messages happened to come first. Stations in no lockstep are answered in threads of Zenoh's.
"""

import contextlib
import gc
import logging
import os
import queue
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from foundation.processes.child_protocol import Finished, Influenced, Ready, Stop, commands, emit
from foundation.profiling.profiler import profiled
from netsim.emulator.service import EmulatorService
from netsim.model.config import ServerConfig
from netsim.transport.interval_stream import BATCH_LIMIT_S, IntervalStream, emulators_end
from netsim.transport.lockstep_radio import directory_key, in_pieces, receive_key, transmit_key
from netsim.transport.profile_groups import PROFILE_GROUPS
from netsim.transport.zenoh_session import Asker, Question, TopicSender, Transport
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import (
    Ack,
    Directory,
    DirectoryRequest,
    RxBatch,
    Station,
    TxBatch,
    decode,
    encode,
)

logger = logging.getLogger(__name__)
OFFER_LIMIT_S = 0.25
"""Wall time for which Zenoh remembers that a station in no lockstep may answer; nobody waits for it."""


class Server:
    """Owns the session and the emulator.

    ``on_visit`` is called when a guest first sends. Raises TransportError, OSError for a log, ValueError for
    settings that do not go together.
    """

    def __init__(self, config: ServerConfig, *, on_visit: Callable[[], None] = lambda: None) -> None:
        self._hosted = EmulatorService(config)
        self._directory = encode(
            Directory(
                run_id=config.run_id,
                vehicles=config.stations,
                guests=tuple(guest.name for guest in config.radio.guests),
            )
        )
        self._visited = False
        self._on_visit = on_visit
        self._malformed = 0
        self._transport = Transport.listen(config.host, config.port)
        try:
            self._hosted.open_logs()  # last: a start that is refused leaves what was there
        except OSError:
            self.close()
            raise
        self._askers: dict[Station, Asker] = {}
        """By station in no lockstep."""
        self._senders: dict[Station, TopicSender] = {}
        """By vehicle in lockstep."""
        for station in range(self._hosted.stations):
            key = receive_key(config.run_id, station)
            if station in config.companions or self._hosted.is_guest(station):
                self._askers[station] = self._transport.asker(key, timeout_s=OFFER_LIMIT_S, lossy=True)
            else:
                self._senders[station] = self._transport.sender(key)
        self._transmissions = self._transport.mailbox(transmit_key(config.run_id))
        self._transport.serve(transmit_key(config.run_id), self._on_transmissions)
        self._transport.serve(directory_key(config.run_id), self._on_directory)

    @property
    def endpoint(self) -> str:
        """Where the stations connect."""
        return self._transport.endpoint

    @property
    def reached_us(self) -> int:
        """How far the air has been simulated."""
        return self._hosted.reached_us

    def serve(self, clock: IntervalStream[Advanced, Advance]) -> dict[str, Any]:
        """Simulate as the time master asks until it hangs up; returns the run's counters.

        Raises ValueError for what it cannot mean.
        """
        while (request := clock.receive()) is not None:
            # Linux weighs who yields among the processes of one session
            self._hosted.give_way(os.sched_yield if _shares_a_processor() else None)
            self.advance(request, clock.send)
        return {"counters": self._hosted.counters, "malformed": self._malformed}

    def close(self) -> None:
        """End the session and the logs; harmless when repeated."""
        self._transport.close()
        self._hosted.close()

    def advance(self, request: Advance, answer: Callable[[Advanced], None] = lambda _: None) -> None:
        """Simulate what an `Advance` asks for, if all that it takes is there; answer it, and deliver.

        In this order: the time master goes on, and who hears from it of a batch waits for that. Raises
        ValueError for what the time master cannot mean.
        """
        missing = self._take_in(request)
        if missing:
            answer(self._hosted.advanced(missing=tuple(sorted(missing))))
            return
        batches = self._hosted.advance(request)
        delivered = sorted(batches.keys() & self._senders.keys())
        answer(self._hosted.advanced(delivered=tuple(delivered)))
        # the first vehicles may have to share this processor, and could not begin before all is sent anyway
        for station in reversed(delivered):
            self._send(self._senders[station], batches.pop(station))
        for station, batch in batches.items():
            self._askers[station].ask(encode(batch))  # it may not be there, or slow: nobody waits for it

    def _take_in(self, request: Advance) -> set[Station]:
        """Take what vehicles have sent; returns those whose batches do not come."""
        missing = self._hosted.missing(request)
        while (payload := self._transmissions.take(BATCH_LIMIT_S if missing else 0.0)) is not None:
            batch = self._submit(payload)
            if batch is not None and batch.now_us == request.at_us and not batch.more:
                missing.discard(batch.station)
        return missing

    def _send(self, sender: TopicSender, batch: RxBatch) -> None:
        for piece in in_pieces(batch):
            sender.send(encode(piece))

    def _submit(self, payload: bytes) -> TxBatch | None:
        """Keep a batch for its interval; None for bytes that are none that a station can have sent."""
        batch = decode(TxBatch, payload)
        if batch is not None and batch.items and not self._visited and self._hosted.is_guest(batch.station):
            # a guest's traffic depends on more than scenario and seed
            self._visited = True
            self._on_visit()
        if batch is None or not self._hosted.submit(batch):
            self._malformed += 1
            logger.warning("dropped %d bytes that are no transmission", len(payload))
            return None
        return batch

    def _on_transmissions(self, question: Question) -> None:
        if self._submit(question.payload) is not None:
            question.answer(_ACK)

    def _on_directory(self, question: Question) -> None:
        if decode(DirectoryRequest, question.payload) is None:
            self._malformed += 1
            return
        question.answer(self._directory)


_ACK = encode(Ack())


def _shares_a_processor() -> bool:
    """Whether this process has been given a processor, with vehicles that wait for it otherwise.

    Where it may go anywhere, others work too, and would take what it leaves.
    """
    return sys.platform == "linux" and len(os.sched_getaffinity(0)) == 1


def run(config_path: Path, clock_fd: int, *, supervised: bool) -> None:
    """Serve as the configuration file says, as long as the time master at the other end of the socket does.

    Raises TransportError, OSError, or ValueError, of which msgspec.DecodeError is one.
    """
    with contextlib.ExitStack() as stack:
        clock = emulators_end(stack.enter_context(socket.socket(fileno=clock_fd)))
        config = msgspec.json.decode(config_path.read_bytes(), type=ServerConfig)
        server = Server(config, on_visit=lambda: emit(Influenced(name="radio", by="a guest on the radio")))
        stack.enter_context(contextlib.closing(server))
        inbox: queue.SimpleQueue[Stop] = queue.SimpleQueue()
        if supervised:
            commands(Stop, inbox)
        # what is there by now stays: no collection need look at it again
        gc.collect()
        gc.freeze()
        emit(Ready(name="radio", pid=os.getpid(), details={"endpoint": server.endpoint}))
        with profiled(
            PROFILE_GROUPS, now_us=lambda: server.reached_us, from_us=config.profile_from_us
        ) as profile:
            details = server.serve(clock)
        if supervised:
            inbox.get()  # who still talks to it has time to end
    emit(Finished(name="radio", details=details | profile))

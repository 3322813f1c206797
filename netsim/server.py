"""The 802.11 emulator's process: Zenoh in front, the emulator behind.

Transmissions are acknowledged at once, in Zenoh's threads, and wait in a list; the main thread takes those
that belong before the interval it is asked to simulate. What belongs to later steps stays, so the air does
not depend on which of two messages happened to come first.
"""

import contextlib
import gc
import logging
import os
import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from netsim.child import Finished, Influenced, Ready, Stop, commands, emit
from netsim.config import ServerConfig
from netsim.hosted import HostedEmulator, Motion
from netsim.parts import PARTS
from netsim.profiler import profiled
from netsim.radio import DELIVERY_LIMIT_S, advance_key, directory_key, receive_key, transmit_key
from netsim.transport import Asker, Question, Transport
from netsim.wire.messages import (
    Ack,
    Advance,
    Advanced,
    Directory,
    DirectoryRequest,
    Station,
    TxBatch,
    decode,
    encode,
)

logger = logging.getLogger(__name__)

__all__ = ["Motion", "Server", "ServerConfig", "run"]


class Server:
    """Owns the session and the emulator; `serve` runs until it is told to stop.

    ``on_visit`` is called when a guest first sends. Raises TransportError, OSError for a log, ValueError for
    settings that do not go together.
    """

    def __init__(
        self,
        config: ServerConfig,
        inbox: "queue.SimpleQueue[Question | Stop]",
        *,
        on_visit: Callable[[], None] = lambda: None,
    ) -> None:
        self._inbox = inbox
        self._hosted = HostedEmulator(config)
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
        self._undelivered: dict[Station, bytes] = {}
        self._transport = Transport.listen(config.host, config.port)
        try:
            self._hosted.open_logs()  # last: a start that is refused leaves what was there
        except OSError:
            self.close()
            raise
        self._receivers: list[Asker] = [
            self._transport.asker(
                receive_key(config.run_id, station),
                timeout_s=DELIVERY_LIMIT_S,
                lossy=self._hosted.is_guest(station),
            )
            for station in range(self._hosted.stations)
        ]
        self._transport.serve(directory_key(config.run_id), self._on_directory)
        self._transport.serve(transmit_key(config.run_id), self._on_transmissions)
        self._transport.serve(advance_key(config.run_id), inbox.put)

    @property
    def endpoint(self) -> str:
        """Where the stations connect."""
        return self._transport.endpoint

    @property
    def reached_us(self) -> int:
        """How far the air has been simulated."""
        return self._hosted.reached_us

    def serve(self) -> dict[str, Any]:
        """Answer the time master until a Stop; returns the run's counters."""
        while True:
            item = self._inbox.get()
            if isinstance(item, Stop):
                break
            request = decode(Advance, item.payload)
            motion = None if request is None else self._hosted.motion(request)
            if request is None or motion is None:
                self._malformed += 1
                logger.warning("dropped %d bytes that tell of no step", len(item.payload))
                continue
            item.answer(encode(self.advance(request, motion)))
        return {"counters": self._hosted.counters, "malformed": self._malformed}

    def close(self) -> None:
        """End the session and the logs; harmless when repeated."""
        self._transport.close()
        self._hosted.close()

    def _on_transmissions(self, question: Question) -> None:
        batch = decode(TxBatch, question.payload)
        if batch is not None and batch.items and not self._visited and self._hosted.is_guest(batch.station):
            # a guest's traffic depends on more than scenario and seed
            self._visited = True
            self._on_visit()
        if batch is None or not self._hosted.submit(batch):
            self._malformed += 1
            logger.warning("dropped %d bytes that are no transmission", len(question.payload))
            return
        question.answer(_ACK)

    def _on_directory(self, question: Question) -> None:
        if decode(DirectoryRequest, question.payload) is None:
            self._malformed += 1
            return
        question.answer(self._directory)

    def advance(self, request: Advance, motion: Motion) -> Advanced:
        """Simulate and deliver what an `Advance` asks for, if that has not been done before."""
        deliveries = self._hosted.advance(request, motion)
        if deliveries is not None:
            self._undelivered = {station: encode(batch) for station, batch in deliveries.items()}
        for station in request.silent:
            self._undelivered.pop(station, None)
        self._deliver()
        return self._hosted.advanced(tuple(self._undelivered))

    def _deliver(self) -> None:
        """Hand every station its arrivals, all at once, and wait a while for the acknowledgements.

        A guest may not be there, or slow: nobody waits for it.
        """
        asked = {station: self._receivers[station].ask(batch) for station, batch in self._undelivered.items()}
        for station, pending in asked.items():
            if self._hosted.is_guest(station) or pending.answer() is not None:
                del self._undelivered[station]


_ACK = encode(Ack())


def run(config_path: Path, *, supervised: bool) -> None:
    """Serve as the configuration file says. Raises TransportError, OSError or msgspec.DecodeError."""
    config = msgspec.json.decode(config_path.read_bytes(), type=ServerConfig)
    inbox: queue.SimpleQueue[Question | Stop] = queue.SimpleQueue()
    server = Server(config, inbox, on_visit=lambda: emit(Influenced(name="radio", by="a guest on the radio")))
    with contextlib.closing(server):
        if supervised:
            commands(Stop, inbox)
        # what is there by now stays: no collection need look at it again
        gc.collect()
        gc.freeze()
        emit(Ready(name="radio", pid=os.getpid(), details={"endpoint": server.endpoint}))
        with profiled(PARTS, now_us=lambda: server.reached_us, from_us=config.profile_from_us) as profile:
            details = server.serve()
    emit(Finished(name="radio", details=details | profile))

"""The 802.11 emulator's process: Zenoh in front, the emulator behind, logs beside it.

Transmissions are acknowledged at once, in Zenoh's threads, and wait in a list; the main thread takes those
that belong before the interval it is asked to simulate. What belongs to later steps stays, so the air does
not depend on which of two messages happened to come first.
"""

import contextlib
import gc
import logging
import os
import queue
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from netsim.child import Finished, Ready, Stop, commands, emit
from netsim.config import ServerConfig
from netsim.emulator import Emulator
from netsim.logs import FRAME_LOG, SESSION_LOG
from netsim.radio import DELIVERY_LIMIT_S, advance_key, receive_key, transmit_key
from netsim.record_log import RecordLog
from netsim.transport import Asker, Question, Transport
from netsim.wire.messages import (
    Ack,
    Advance,
    Advanced,
    RxBatch,
    RxItem,
    Station,
    TxBatch,
    decode,
    encode,
    unpack_rows,
)

logger = logging.getLogger(__name__)

Doubles = NDArray[np.float64]
_Motion = tuple[Doubles, Doubles]

STREAM = 802
"""Sets the emulator's random streams apart from those of the run's other processes."""


class Server:
    """Owns the session, the emulator and the logs; `serve` runs until it is told to stop."""

    def __init__(self, config: ServerConfig, inbox: "queue.SimpleQueue[Question | Stop]") -> None:
        self._config = config
        self._inbox = inbox
        self._emulator = Emulator(
            config=config.radio, stations=config.stations, seed=np.random.SeedSequence([config.seed, STREAM])
        )
        self._submitted: list[TxBatch] = []
        self._malformed = 0
        self._silent: frozenset[Station] = frozenset()
        self._reached_us = 0
        self._undelivered: dict[Station, bytes] = {}
        self._frame_log = _log(config.frame_log_path, FRAME_LOG)
        self._session_log = _log(config.session_log_path, SESSION_LOG)
        self._transport = Transport.listen(config.host, config.port)
        self._receivers: list[Asker] = [
            self._transport.asker(receive_key(config.run_id, station), timeout_s=DELIVERY_LIMIT_S)
            for station in range(config.stations)
        ]
        self._transport.serve(transmit_key(config.run_id), self._on_transmissions)
        self._transport.serve(advance_key(config.run_id), inbox.put)

    @property
    def endpoint(self) -> str:
        """Where the stations connect."""
        return self._transport.endpoint

    def serve(self) -> dict[str, Any]:
        """Answer the time master until a Stop; returns the run's counters."""
        while True:
            item = self._inbox.get()
            if isinstance(item, Stop):
                break
            request = decode(Advance, item.payload)
            motion = None if request is None else self._motion(request)
            if request is None or motion is None:
                self._malformed += 1
                continue
            item.answer(encode(self._advance(request, motion)))
        return {"counters": msgspec.to_builtins(self._emulator.counters), "malformed": self._malformed}

    def close(self) -> None:
        """End the session and the logs; harmless when repeated."""
        self._transport.close()
        for log in (self._frame_log, self._session_log):
            if log is not None:
                log.close()

    def _on_transmissions(self, question: Question) -> None:
        batch = decode(TxBatch, question.payload)
        if batch is None or batch.station >= self._config.stations:
            self._malformed += 1
            logger.warning("dropped %d bytes that are no transmission", len(question.payload))
            return
        if batch.items:
            self._submitted.append(batch)
        question.answer(_ACK)

    def _motion(self, request: Advance) -> _Motion | None:
        """Positions and velocities of an `Advance`; None unless they are all stations', finite and ahead."""
        stations = self._config.stations
        pos_ned_m = unpack_rows(request.pos_ned_m, stations=stations, columns=3)
        vel_ned_m_s = unpack_rows(request.vel_ned_m_s, stations=stations, columns=3)
        if pos_ned_m is None or vel_ned_m_s is None or request.to_us < self._reached_us:
            return None
        return (pos_ned_m, vel_ned_m_s) if np.isfinite(pos_ned_m + vel_ned_m_s).all() else None

    def _advance(self, request: Advance, motion: _Motion) -> Advanced:
        for station in frozenset(request.silent) - self._silent:
            self._emulator.set_silent(station)
            self._undelivered.pop(station, None)
        self._silent = frozenset(request.silent)
        if request.to_us > self._reached_us:
            self._simulate(request, *motion)
            self._reached_us = request.to_us
        self._deliver()
        return Advanced(
            to_us=self._reached_us,
            quiet_until_us=self._emulator.next_event_us,
            busy_ns=self._emulator.busy_ns,
            unresponsive=tuple(self._undelivered),
        )

    def _simulate(self, request: Advance, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        # Zenoh's threads append to the list while this runs, so what is taken is cut off by position first.
        count = len(self._submitted)
        batches = self._submitted[:count]
        del self._submitted[:count]
        later = [batch for batch in batches if batch.now_us >= request.to_us]
        self._submitted.extend(later)
        due = [batch for batch in batches if batch.now_us < request.to_us]
        for batch in sorted(due, key=lambda batch: (batch.now_us, batch.station)):
            self._emulator.submit(batch)
        self._emulator.set_extra_attenuation_db(request.extra_attenuation_db)
        arrivals: dict[Station, list[RxItem]] = {}
        for station, item in self._emulator.advance(
            to_us=request.to_us, at_us=request.at_us, pos_ned_m=pos_ned_m, vel_ned_m_s=vel_ned_m_s
        ):
            arrivals.setdefault(station, []).append(item)
        self._undelivered = {
            station: encode(RxBatch(station=station, release_us=request.release_us, items=tuple(items)))
            for station, items in arrivals.items()
            if station not in self._silent
        }
        self._write_logs()

    def _write_logs(self) -> None:
        frames, sessions = self._emulator.take_frames(), self._emulator.take_sessions()
        if self._frame_log is not None:
            self._frame_log.append(frames)
        if self._session_log is not None:
            self._session_log.append(sessions)

    def _deliver(self) -> None:
        """Hand every station its arrivals, all at once, and wait a while for the acknowledgements."""
        asked = {station: self._receivers[station].ask(batch) for station, batch in self._undelivered.items()}
        for station, pending in asked.items():
            if pending.answer() is not None:
                del self._undelivered[station]


def _log(path: str | None, dtype: np.dtype[Any]) -> RecordLog | None:
    return None if path is None else RecordLog(path, dtype)


_ACK = encode(Ack())


def run(config_path: Path, *, supervised: bool) -> None:
    """Serve as the configuration file says. Raises TransportError, OSError or msgspec.DecodeError."""
    config = msgspec.json.decode(config_path.read_bytes(), type=ServerConfig)
    inbox: queue.SimpleQueue[Question | Stop] = queue.SimpleQueue()
    server = Server(config, inbox)
    with contextlib.closing(server):
        if supervised:
            commands(Stop, inbox)
        # what is there by now stays: no collection need look at it again
        gc.collect()
        gc.freeze()
        emit(Ready(name="radio", pid=os.getpid(), details={"endpoint": server.endpoint}))
        details = server.serve()
    emit(Finished(name="radio", details=details))

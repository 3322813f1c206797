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
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from netsim.child import Finished, Ready, Stop, commands, emit
from netsim.config import ServerConfig
from netsim.emulator import Emulator
from netsim.logs import FRAME_LOG, SESSION_LOG
from netsim.radio import ANSWER_LIMIT_S, advance_key, receive_key, transmit_key
from netsim.record_log import RecordLog
from netsim.transport import Asker, Pending, Question, Transport
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
        self._frame_log = _log(config.frame_log_path, FRAME_LOG)
        self._session_log = _log(config.session_log_path, SESSION_LOG)
        self._transport = Transport.listen(config.host, config.port)
        self._receivers: list[Asker] = [
            self._transport.asker(receive_key(config.run_id, station), timeout_s=ANSWER_LIMIT_S)
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
            poses = None if request is None else _poses(request, self._config.stations)
            if request is None or poses is None:
                self._malformed += 1
                continue
            item.answer(encode(self._advance(request, poses)))
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

    def _advance(self, request: Advance, poses: "_Poses") -> Advanced:
        # Zenoh's threads append to the list while this runs, so what is taken is cut off by position first.
        count = len(self._submitted)
        batches = self._submitted[:count]
        del self._submitted[:count]
        later = [batch for batch in batches if batch.now_us >= request.to_us]
        self._submitted.extend(later)
        due = [batch for batch in batches if batch.now_us < request.to_us]
        for batch in sorted(due, key=lambda batch: (batch.now_us, batch.station)):
            self._emulator.submit(batch)
        for station in frozenset(request.silent) - self._silent:
            self._emulator.set_silent(station)
        self._silent = frozenset(request.silent)
        self._emulator.set_extra_attenuation_db(request.extra_attenuation_db)
        arrivals = self._emulator.advance(
            to_us=request.to_us,
            pos_ned_m=poses.pos_ned_m,
            vel_ned_m_s=poses.vel_ned_m_s,
            q_ned_frd=poses.q_ned_frd,
        )
        unresponsive = self._deliver(arrivals, request.release_us)
        self._write_logs()
        return Advanced(
            to_us=request.to_us,
            quiet_until_us=self._emulator.next_event_us,
            busy_ns=self._emulator.busy_ns,
            unresponsive=unresponsive,
        )

    def _write_logs(self) -> None:
        frames, sessions = self._emulator.take_frames(), self._emulator.take_sessions()
        if self._frame_log is not None:
            self._frame_log.append(frames)
        if self._session_log is not None:
            self._session_log.append(sessions)

    def _deliver(self, arrivals: list[tuple[Station, RxItem]], release_us: int) -> tuple[Station, ...]:
        """Hand every station its arrivals, all at once, and wait.

        Returns the stations that did not acknowledge.
        """
        by_station: dict[Station, list[RxItem]] = {}
        for station, item in arrivals:
            if station not in self._silent:
                by_station.setdefault(station, []).append(item)
        pending: dict[Station, Pending] = {}
        for station, items in by_station.items():
            batch = RxBatch(station=station, release_us=release_us, items=tuple(items))
            pending[station] = self._receivers[station].ask(encode(batch))
        return tuple(station for station, answer in pending.items() if answer.answer() is None)


class _Poses(NamedTuple):
    """Those of an `Advance`, unpacked."""

    pos_ned_m: NDArray[np.float64]
    vel_ned_m_s: NDArray[np.float64]
    q_ned_frd: NDArray[np.float64]


def _poses(request: Advance, stations: int) -> _Poses | None:
    """Poses of so many stations, or None if the request holds those of another number."""
    pos_ned_m = unpack_rows(request.pos_ned_m, stations=stations, columns=3)
    vel_ned_m_s = unpack_rows(request.vel_ned_m_s, stations=stations, columns=3)
    q_ned_frd = unpack_rows(request.q_ned_frd, stations=stations, columns=4)
    if pos_ned_m is None or vel_ned_m_s is None or q_ned_frd is None:
        return None
    return _Poses(pos_ned_m, vel_ned_m_s, q_ned_frd)


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

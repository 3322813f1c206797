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
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from netsim.capture.writer import Capture
from netsim.child import Finished, Influenced, Ready, Stop, commands, emit
from netsim.config import ServerConfig
from netsim.emulator import Emulator
from netsim.logs import FRAME_LOG, SESSION_LOG
from netsim.phy.medium import Transmission
from netsim.radio import DELIVERY_LIMIT_S, advance_key, directory_key, receive_key, transmit_key
from netsim.record_log import RecordLog
from netsim.transport import Asker, Question, Transport
from netsim.wire.messages import (
    Ack,
    Advance,
    Advanced,
    Directory,
    DirectoryRequest,
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


class Motion(NamedTuple):
    """Positions (n, 3), velocities (n, 3) and attitudes (n, 4), wxyz, of the stations."""

    pos_ned_m: Doubles
    vel_ned_m_s: Doubles
    q_ned_frd: Doubles


LEAD_US = 60_000_000
"""How far ahead of the air a transmission's time may lie."""
FARTHEST_M, FASTEST_M_S, NORM_TOLERANCE = 1e8, 1e5, 1e-3
"""What a vehicle's state may be: limits against senseless numbers."""
STREAM = 802
"""Sets the emulator's random streams apart from those of the run's other processes."""


class Server:
    """Owns the session, the emulator and the logs; `serve` runs until it is told to stop.

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
        self._config = config
        self._inbox = inbox
        radio = config.radio
        self._stations = config.stations + len(radio.guests)
        self._guests_pos_ned_m = np.array([guest.pos_ned_m for guest in radio.guests]).reshape(-1, 3)
        self._capture: Capture | None = None
        self._emulator = Emulator(
            config=radio,
            stations=self._stations,
            seed=np.random.SeedSequence([config.seed, STREAM]),
            on_transmission=None if config.capture_path is None else self._on_transmission,
        )
        self._directory = encode(
            Directory(
                run_id=config.run_id,
                vehicles=config.stations,
                guests=tuple(guest.name for guest in radio.guests),
            )
        )
        self._visited = False
        self._on_visit = on_visit
        self._submitted: list[TxBatch] = []
        self._malformed = 0
        self._silent: frozenset[Station] = frozenset()
        self._reached_us = 0
        self._undelivered: dict[Station, bytes] = {}
        self._frame_log: RecordLog | None = None
        self._session_log: RecordLog | None = None
        self._transport = Transport.listen(config.host, config.port)
        try:
            # files come last: a start that is refused leaves what was there
            self._frame_log = _log(config.frame_log_path, FRAME_LOG)
            self._session_log = _log(config.session_log_path, SESSION_LOG)
            if config.capture_path is not None:
                self._capture = Capture(config.capture_path, config=radio, comment=f"seed {config.seed}")
        except OSError:
            self.close()
            raise
        self._receivers: list[Asker] = [
            self._transport.asker(
                receive_key(config.run_id, station),
                timeout_s=DELIVERY_LIMIT_S,
                lossy=station >= config.stations,
            )
            for station in range(self._stations)
        ]
        self._transport.serve(directory_key(config.run_id), self._on_directory)
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
                logger.warning("dropped %d bytes that tell of no step", len(item.payload))
                continue
            item.answer(encode(self.advance(request, motion)))
        return {"counters": msgspec.to_builtins(self._emulator.counters), "malformed": self._malformed}

    def close(self) -> None:
        """End the session and the logs; harmless when repeated."""
        self._transport.close()
        for log in (self._frame_log, self._session_log, self._capture):
            if log is not None:
                log.close()

    def _on_transmissions(self, question: Question) -> None:
        batch = decode(TxBatch, question.payload)
        if batch is None or batch.station >= self._stations or self._too_early(batch):
            self._malformed += 1
            logger.warning("dropped %d bytes that are no transmission", len(question.payload))
            return
        if batch.items:
            if batch.station >= self._config.stations:
                batch = _at_once(batch)
                if not self._visited:
                    # a guest's traffic depends on more than scenario and seed
                    self._visited = True
                    self._on_visit()
            self._submitted.append(batch)
        question.answer(_ACK)

    def _too_early(self, batch: TxBatch) -> bool:
        """Whether a vehicle speaks of a time far ahead; guests have none."""
        latest_us = max((item.at_us for item in batch.items), default=0)
        return (
            batch.station < self._config.stations
            and max(batch.now_us, latest_us) > self._reached_us + LEAD_US
        )

    def _on_transmission(self, transmission: Transmission) -> None:
        if self._capture is not None:
            self._capture.append(transmission)

    def _on_directory(self, question: Question) -> None:
        if decode(DirectoryRequest, question.payload) is None:
            self._malformed += 1
            return
        question.answer(self._directory)

    def _motion(self, request: Advance) -> Motion | None:
        """Where an `Advance` puts the vehicles; None unless it is all of them, somewhere, and ahead."""
        vehicles = self._config.stations
        pos_ned_m = unpack_rows(request.pos_ned_m, stations=vehicles, columns=3)
        vel_ned_m_s = unpack_rows(request.vel_ned_m_s, stations=vehicles, columns=3)
        q_ned_frd = unpack_rows(request.q_ned_frd, stations=vehicles, columns=4)
        if pos_ned_m is None or vel_ned_m_s is None or q_ned_frd is None:
            return None
        motion = Motion(pos_ned_m, vel_ned_m_s, q_ned_frd)
        norms = np.linalg.norm(q_ned_frd, axis=1)
        # comparisons that what is not a number fails as well
        somewhere = (np.abs(pos_ned_m) <= FARTHEST_M).all() and (np.abs(vel_ned_m_s) <= FASTEST_M_S).all()
        upright = (np.abs(norms - 1.0) <= NORM_TOLERANCE).all()
        known = all(station < self._stations for station in request.silent)
        return motion if known and somewhere and upright and request.to_us >= self._reached_us else None

    def _with_guests(self, motion: Motion) -> Motion:
        """Motion of all stations: guests stand still, upright."""
        guests = len(self._guests_pos_ned_m)
        if guests == 0:
            return motion
        return Motion(
            np.vstack([motion.pos_ned_m, self._guests_pos_ned_m]),
            np.vstack([motion.vel_ned_m_s, np.zeros((guests, 3))]),
            np.vstack([motion.q_ned_frd, np.tile([1.0, 0.0, 0.0, 0.0], (guests, 1))]),
        )

    def advance(self, request: Advance, motion: Motion) -> Advanced:
        """Simulate and deliver what an `Advance` asks for, if that has not been done before."""
        for station in frozenset(request.silent) - self._silent:
            self._emulator.set_silent(station)
            self._undelivered.pop(station, None)
        self._silent = frozenset(request.silent)
        if request.to_us > self._reached_us:
            self._simulate(request, self._with_guests(motion))
            self._reached_us = request.to_us
        self._deliver()
        return Advanced(
            to_us=self._reached_us,
            quiet_until_us=self._emulator.next_event_us,
            busy_ns=self._emulator.busy_ns,
            unresponsive=tuple(self._undelivered),
        )

    def _simulate(self, request: Advance, motion: Motion) -> None:
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
            to_us=request.to_us,
            at_us=request.at_us,
            pos_ned_m=motion.pos_ned_m,
            vel_ned_m_s=motion.vel_ned_m_s,
            q_ned_frd=motion.q_ned_frd,
        ):
            arrivals.setdefault(station, []).append(item)
        self._undelivered = {
            station: encode(RxBatch(station=station, release_us=request.release_us, items=tuple(items)))
            for station, items in arrivals.items()
            if station not in self._silent
        }
        self._write_logs()
        if self._capture is not None:
            self._capture.settle(1_000 * request.to_us)

    def _write_logs(self) -> None:
        frames, sessions = self._emulator.take_frames(), self._emulator.take_sessions()
        if self._frame_log is not None:
            self._frame_log.append(frames)
        if self._session_log is not None:
            self._session_log.append(sessions)

    def _deliver(self) -> None:
        """Hand every station its arrivals, all at once, and wait a while for the acknowledgements.

        A guest may not be there, or slow: nobody waits for it.
        """
        asked = {station: self._receivers[station].ask(batch) for station, batch in self._undelivered.items()}
        for station, pending in asked.items():
            if station >= self._config.stations or pending.answer() is not None:
                del self._undelivered[station]


def _at_once(batch: TxBatch) -> TxBatch:
    """Batch of a guest, whose time is not the simulation's: whatever it says, it means now."""
    items = tuple(msgspec.structs.replace(item, at_us=0) for item in batch.items)
    return msgspec.structs.replace(batch, now_us=0, items=items)


def _log(path: str | None, dtype: np.dtype[Any]) -> RecordLog | None:
    return None if path is None else RecordLog(path, dtype)


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
        details = server.serve()
    emit(Finished(name="radio", details=details))

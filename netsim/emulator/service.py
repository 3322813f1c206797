"""The emulator behind the messages of `netsim.wire`: accepts batches, simulates intervals, writes logs.

It sits between `netsim.emulator.emulator` and the transport: sockets (`netsim.transport.server`), or direct
calls in one process. Its only I/O is the log files.
"""

import contextlib
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from foundation.records.record_log import RecordLog
from netsim.capture.pcapng_writer import Capture
from netsim.emulator.emulator import Emulator
from netsim.emulator.interface import NetworkEmulator
from netsim.emulator.log_layout import FRAME_LOG, RECEPTION_LOG, SESSION_LOG
from netsim.emulator.packets import PacketReception
from netsim.emulator.records import frame_log_rows, reception_log_rows
from netsim.emulator.serial_modems import SerialModems
from netsim.model.config import ServerConfig
from netsim.phy.frames import Transmission
from netsim.phy.propagation import is_possible
from netsim.wire.lockstep import LEAD_US, Advance, Advanced, unpack_rows
from netsim.wire.messages import RxBatch, SerialBytes, Station, TxBatch
from netsim.wire.packets import SentPacket

Doubles = NDArray[np.float64]


_SESSION_FIELDS = attrgetter(*(SESSION_LOG.names or ()))
_BATCH_ORDER = attrgetter("now_us", "station")
_REJECTED = "the 802.11 emulator rejects the request to advance: bad motion, station or time"
STREAM = 802
"""Key of the emulator's random streams, different from those of the run's other processes."""


def make_emulator(config: ServerConfig) -> NetworkEmulator:
    """Return the network emulator of a run. Raises ValueError for inconsistent settings."""
    return EmulatorService(config)


class EmulatorService:
    """The emulator, the batches submitted and not yet simulated, and the logs.

    `submit` may be called from any thread, all other methods from one. Raises ValueError for inconsistent
    settings; `open_logs` creates the files.
    """

    def __init__(self, config: ServerConfig) -> None:
        self._config = config
        radio = config.radio
        self.stations = config.stations + len(radio.guests)
        """Number of vehicles and guests."""
        self._guests_pos_ned_m = np.array([guest.pos_ned_m for guest in radio.guests]).reshape(-1, 3)
        observed = config.capture_path is not None or config.reception_log_path is not None
        self._emulator = Emulator(
            config=radio,
            stations=self.stations,
            seed=np.random.SeedSequence([config.seed, STREAM]),
            on_transmission=self._on_transmission if observed else None,
            uwb=config.uwb,
        )
        self._modems: SerialModems | None = None
        if config.serial is not None:
            self._modems = SerialModems(
                config.serial,
                radio=radio,
                vehicles=config.stations,
                stations=self.stations,
                seed=np.random.SeedSequence([config.seed, STREAM]),
            )
            self._emulator.set_silent(config.serial.ground_station)  # it has modems only
        self._submitted: list[TxBatch] = []
        self._silent: frozenset[Station] = frozenset()
        self.reached_us = 0
        """Time up to which the channel has been simulated."""
        self._capture: Capture | None = None
        self._frame_log: RecordLog | None = None
        self._session_log: RecordLog | None = None
        self._reception_log: RecordLog | None = None
        self._ended = 0
        """Number of frames that have ended, for the log of receptions."""
        self._files = contextlib.ExitStack()

    def open_logs(self) -> None:
        """Create the log files named in the settings. Raises OSError."""
        config, keep = self._config, self._files.enter_context
        if config.frame_log_path is not None:
            log = RecordLog(config.frame_log_path, FRAME_LOG, block_rows=config.log_block_rows)
            self._frame_log = keep(contextlib.closing(log))
        if config.session_log_path is not None:
            log = RecordLog(config.session_log_path, SESSION_LOG, block_rows=config.log_block_rows)
            self._session_log = keep(contextlib.closing(log))
        if config.reception_log_path is not None:
            self._reception_log = keep(
                contextlib.closing(RecordLog(config.reception_log_path, RECEPTION_LOG))
            )
        if config.capture_path is not None:
            capture = Capture(
                config.capture_path,
                config=config.radio,
                vehicles=config.stations,
                epoch_unix_us=config.epoch_unix_us,
                comment=f"seed {config.seed}",
            )
            self._capture = keep(contextlib.closing(capture))

    def close(self) -> None:
        """Write the rest of the logs and close them; repeated calls have no effect."""
        self._files.close()

    @property
    def counters(self) -> dict[str, Any]:
        """Counters of the run, by name."""
        counters: dict[str, Any] = msgspec.to_builtins(self._emulator.counters)
        return counters if self._modems is None else counters | {"serial_radio": self._modems.counters}

    def is_guest(self, station: Station) -> bool:
        """Whether the station's host is an external program."""
        return self._config.stations <= station < self.stations

    def submit(self, batch: TxBatch) -> bool:
        """Store a batch until its interval.

        Returns False for an unknown station, a modem that it does not have, or a time too far ahead.
        """
        if batch.station >= self.stations or self._too_early(batch) or not self._has_modems(batch):
            return False
        if batch.items:
            self._submitted.append(_at_once(batch) if self.is_guest(batch.station) else batch)
        return True

    def _too_early(self, batch: TxBatch) -> bool:
        """Whether a vehicle's batch is more than `LEAD_US` ahead; guests have no simulation time."""
        latest_us = max((item.at_us for item in batch.items), default=0)
        return (
            batch.station < self._config.stations and max(batch.now_us, latest_us) > self.reached_us + LEAD_US
        )

    def _has_modems(self, batch: TxBatch) -> bool:
        """Whether the sender has the modems to which it writes."""
        peers = {item.peer for item in batch.items if isinstance(item, SerialBytes)}
        modems = self._modems
        return not peers or (
            modems is not None and all(modems.has_modem(batch.station, peer) for peer in peers)
        )

    def _on_transmission(self, transmission: Transmission) -> None:
        if self._capture is not None:
            self._capture.append(transmission)
        if self._reception_log is not None:
            self._reception_log.append_array(reception_log_rows(self._ended, transmission))
            self._ended += 1

    def missing(self, request: Advance) -> set[Station]:
        """Return the senders of an interval whose batches are missing or incomplete."""
        missing = set(request.senders) - set(request.silent)
        if missing:
            at_us = request.at_us
            missing -= {b.station for b in self._submitted if b.now_us == at_us and not b.more}
        return missing

    def _motion(self, request: Advance) -> tuple[Doubles, Doubles, Doubles]:
        """Return positions (n, 3) in m, velocities (n, 3) in m/s and attitudes (n, 4), wxyz, of all stations.

        Guests are at rest and level. Raises ValueError if the request is invalid.
        """
        vehicles = self._config.stations
        pos_ned_m = unpack_rows(request.pos_ned_m, stations=vehicles, columns=3)
        vel_ned_m_s = unpack_rows(request.vel_ned_m_s, stations=vehicles, columns=3)
        q_ned_frd = unpack_rows(request.q_ned_frd, stations=vehicles, columns=4)
        if pos_ned_m is None or vel_ned_m_s is None or q_ned_frd is None:
            raise ValueError(_REJECTED)
        possible = is_possible(pos_ned_m, vel_ned_m_s, q_ned_frd)
        named = (*request.senders, *request.silent, *(station for station, _ in request.range_offsets_m))
        known = max(named, default=0) < self.stations
        if not (known and possible and request.to_us > self.reached_us):
            raise ValueError(_REJECTED)
        guests_ned_m = self._guests_pos_ned_m
        if len(guests_ned_m) == 0:
            return pos_ned_m, vel_ned_m_s, q_ned_frd
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(guests_ned_m), 1))
        at_rest = np.vstack([vel_ned_m_s, np.zeros_like(guests_ned_m)])
        return np.vstack([pos_ned_m, guests_ned_m]), at_rest, np.vstack([q_ned_frd, level])

    def set_between_events(self, function: Callable[[], object] | None) -> None:
        """Set a function that is called between events; None removes it."""
        self._emulator.queue.between = function

    def advance(self, request: Advance) -> dict[Station, RxBatch]:
        """Simulate the interval of an `Advance` and return its deliveries by station.

        Raises ValueError as `begin`.
        """
        self.begin(request)
        self.run_until(1_000 * request.to_us)
        return self.end(request)

    def begin(self, request: Advance) -> None:
        """Begin the interval of an `Advance` with the batches that are due.

        Raises ValueError unless it has finite motion of all vehicles, known stations and a later time.
        """
        pos_ned_m, vel_ned_m_s, q_ned_frd = self._motion(request)
        for station in frozenset(request.silent) - self._silent:
            self._emulator.set_silent(station)
        self._silent |= frozenset(request.silent)  # a request may be older than the loss of a vehicle
        # other threads append to the list meanwhile: copy and delete the same leading part
        count = len(self._submitted)
        batches = self._submitted[:count]
        del self._submitted[:count]
        later = [batch for batch in batches if batch.now_us >= request.to_us]
        self._submitted.extend(later)
        due = [batch for batch in batches if batch.now_us < request.to_us]
        for batch in sorted(due, key=_BATCH_ORDER):
            self._emulator.submit(batch if self._modems is None else _submit_serial(self._modems, batch))
        self._emulator.set_extra_attenuation_db(request.extra_attenuation_db)
        if self._modems is not None:
            self._modems.set_extra_attenuation_db(request.extra_attenuation_db)
            self._modems.set_motion(1_000 * request.at_us, pos_ned_m, vel_ned_m_s, q_ned_frd)
        self._emulator.range_offsets_m = dict(request.range_offsets_m)
        self._emulator.begin(
            to_us=request.to_us,
            at_us=request.at_us,
            pos_ned_m=pos_ned_m,
            vel_ned_m_s=vel_ned_m_s,
            q_ned_frd=q_ned_frd,
        )

    def run_until(self, time_ns: int) -> None:
        """Simulate up to and including ``time_ns``, which is within the interval that has begun."""
        self._emulator.run_until(time_ns)
        if self._modems is not None:
            self._modems.run_until(time_ns)

    def end(self, request: Advance) -> dict[Station, RxBatch]:
        """End the interval, which has been simulated completely; return its deliveries by station."""
        if self._modems is not None:
            for received in self._modems.take():
                self._emulator.add_item(*received)
        arrivals = self._emulator.end()
        self._write_logs()
        if self._capture is not None:
            self._capture.settle(1_000 * request.to_us)
        self.reached_us = request.to_us
        return {
            station: RxBatch(station=station, release_us=request.release_us, items=tuple(items))
            for station, items in arrivals.items()
            if station not in self._silent
        }

    @property
    def next_event_ns(self) -> int:
        """Earliest time of the next event on the channel without further submissions."""
        next_ns = self._emulator.next_event_ns
        return next_ns if self._modems is None else min(next_ns, self._modems.next_event_ns)

    def submit_packet(self, packet: SentPacket, at_ns: int) -> bool:
        """Queue a packet at ``at_ns`` or now; return False unless its sender is a vehicle."""
        if packet.station >= self._config.stations:
            return False
        self._emulator.submit_packet(packet, at_ns)
        return True

    def take_packets(self) -> list[PacketReception]:
        """Return the packets received since the last call, in order of their end."""
        return self._emulator.take_packets()

    def take_ended(self) -> dict[Station, int]:
        """Return the numbers of packets that have left the queues since the last call, by sender."""
        return self._emulator.take_ended()

    def advanced(self, *, delivered: tuple[Station, ...] = (), missing: tuple[Station, ...] = ()) -> Advanced:
        """Return the reply to the time master after `advance`, or instead of it if senders are missing."""
        return Advanced(
            to_us=self.reached_us,
            quiet_until_us=self.next_event_ns // 1_000,
            busy_ns=self._emulator.busy_ns,
            delivered=delivered,
            missing=missing,
        )

    def _write_logs(self) -> None:
        frames, sessions = self._emulator.take_frame_rows(), self._emulator.take_sessions()
        if self._frame_log is not None and len(frames):
            self._frame_log.append_array(frame_log_rows(frames))
        if self._session_log is not None:
            self._session_log.append(map(_SESSION_FIELDS, sessions))


def _submit_serial(modems: SerialModems, batch: TxBatch) -> TxBatch:
    """Write the bytes in a batch to the sender's modems; return the batch without them."""
    serial = [item for item in batch.items if isinstance(item, SerialBytes)]
    if not serial:
        return batch
    modems.submit(batch.station, serial)
    return msgspec.structs.replace(
        batch, items=tuple(item for item in batch.items if not isinstance(item, SerialBytes))
    )


def _at_once(batch: TxBatch) -> TxBatch:
    """Return a guest's batch with all times set to 0 (at once): its clock is not the simulation's."""
    items = tuple(msgspec.structs.replace(item, at_us=0) for item in batch.items)
    return msgspec.structs.replace(batch, now_us=0, items=items)

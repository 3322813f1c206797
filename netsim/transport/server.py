"""Server process of the 802.11 emulator, with Zenoh and the time master's interval stream.

One thread receives an interval request from the time master, collects the vehicles' batches, simulates, and
sends the deliveries. Vehicles publish without acknowledgement, which runs no Python code here; the request
lists the senders, and the server waits for their batches. Batches of later steps are kept, so the simulation
does not depend on the order of messages. Guests are served in Zenoh threads, each at a key of its own.
Packets of network interfaces are exchanged during an interval (`netsim.transport.packet_exchange`).
"""

import contextlib
import gc
import os
import queue
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from foundation.processes.child_protocol import Finished, Influenced, Ready, Stop, commands, emit
from foundation.processes.message_stream import MessageStream
from foundation.processes.scheduling import end_waits_on_time
from foundation.profiling.profiler import profiled
from netsim.emulator.interface import NetworkEmulator
from netsim.emulator.service import make_emulator
from netsim.emulator.warm_up import warm_up
from netsim.model.config import ServerConfig
from netsim.transport.guest_intake import LONGEST_GUEST_BATCH_BYTES, GuestIntake
from netsim.transport.interval_stream import BATCH_LIMIT_S, emulators_end
from netsim.transport.lockstep_radio import (
    directory_key,
    guest_transmit_key,
    in_pieces,
    packets_received_key,
    packets_sent_key,
    receive_key,
    transmit_key,
)
from netsim.transport.malformed import MalformedCount
from netsim.transport.packet_exchange import MOST_WAITING_BYTES, MOST_WAITING_MESSAGES, PacketExchange
from netsim.transport.packet_inbox import PacketInbox
from netsim.transport.profile_groups import PROFILE_GROUPS
from netsim.transport.radio_users import rights
from netsim.transport.socket_folder import unix_endpoint
from netsim.transport.zenoh_session import MOST_WAITING, Asker, Question, TopicSender, Transport
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import Ack, Directory, DirectoryRequest, RxBatch, Station, TxBatch, decode, encode

OFFER_LIMIT_S = 0.25
"""Time-out of queries to guests, wall time; the server does not wait for replies."""
GUEST, FOREIGN = "a guest on the radio", "a program that uses the vehicles' password"
PROGRAMS = "programs on the radio"
"""What may influence a run."""


class Server:
    """The Zenoh session and the emulator.

    ``on_influence`` is called with the cause, `GUEST`, `FOREIGN` or `PROGRAMS`, when the run begins to depend
    on more than scenario and seed; once for each. Raises TransportError, OSError for a log file, ValueError
    for inconsistent settings.
    """

    def __init__(self, config: ServerConfig, *, on_influence: Callable[[str], None] = lambda _: None) -> None:
        self._service: NetworkEmulator = make_emulator(config)
        self._directory = encode(
            Directory(
                run_id=config.run_id,
                vehicles=config.stations,
                guests=tuple(guest.name for guest in config.radio.guests),
            )
        )
        self._influences: set[str] = set()
        self._on_influence = on_influence
        names = {config.stations + i: f"guest {guest.name}" for i, guest in enumerate(config.radio.guests)}
        self._vehicles = config.stations
        self._intake = GuestIntake(names)
        self._malformed = {
            name: MalformedCount(f"message of {name}") for name in (_VEHICLES, _DIRECTORY, *names.values())
        }
        self._by_key = {guest_transmit_key(config.run_id, station): station for station in names}
        self._transport = Transport.listen(_endpoint(config), rights(config))
        self.endpoint = self._transport.endpoint
        """Endpoint to which the stations connect."""
        try:
            self._service.open_logs()  # last, so that a failed start keeps existing files
        except OSError:
            self.close()
            raise
        self._askers: dict[Station, Asker] = {}
        """By guest's station."""
        self._senders: dict[Station, TopicSender] = {}
        """By vehicle in lockstep."""
        for station in range(self._service.stations):
            key = receive_key(config.run_id, station)
            if self._service.is_guest(station):
                self._askers[station] = self._transport.asker(key, timeout_s=OFFER_LIMIT_S, lossy=True)
            else:
                self._senders[station] = self._transport.sender(key)
        self._packets = self._packet_exchange(config) if config.packets else None
        self._transmissions = self._transport.mailbox(transmit_key(config.run_id))
        all_at_once = max(MOST_WAITING, self._service.stations)
        self._transport.serve(transmit_key(config.run_id), self._on_declared, most_waiting=all_at_once)
        for key in self._by_key:  # each with a buffer of its own, which no other guest can fill
            self._transport.serve(key, self._on_guest)
        self._transport.serve(directory_key(config.run_id), self._on_directory, most_waiting=all_at_once)

    def _packet_exchange(self, config: ServerConfig) -> PacketExchange:
        transport = self._transport
        exchange = PacketExchange(
            self._service,
            PacketInbox(
                most_waiting=MOST_WAITING_MESSAGES + config.stations * config.radio.queue_frames,
                most_bytes=MOST_WAITING_BYTES,
            ),
            vehicles=config.stations,
            publish=transport.sender(packets_received_key(config.run_id)).send,
            now_ns=time.monotonic_ns,
            on_packets=lambda: self._influence(PROGRAMS),
            on_malformed=lambda: self._influence(FOREIGN),
        )
        transport.subscribe(packets_sent_key(config.run_id), exchange.receive)
        return exchange

    @property
    def reached_us(self) -> int:
        """Time up to which the channel has been simulated."""
        return self._service.reached_us

    def serve(self, clock: MessageStream[Advanced, Advance]) -> dict[str, Any]:
        """Simulate requested intervals until the stream is closed; return the run's counters.

        Raises ValueError for an invalid request.
        """
        later: deque[Advance] = deque()
        """Requests that arrived before the repetition of an earlier one."""
        while (request := later.popleft() if later else clock.receive()) is not None:
            # Linux weighs sched_yield among the processes of one session, here the vehicles on this processor
            self._service.set_between_events(os.sched_yield if _shares_a_processor() else None)
            while not self.advance(request, clock.send):
                repeated = _repetition(request, clock, later)
                if repeated is None:
                    break
                request = repeated
        packets = {} if self._packets is None else {"packets": self._packets.counters}
        return {"counters": self._service.counters} | self.refused | packets

    @property
    def refused(self) -> dict[str, dict[str, int]]:
        """Numbers of invalid messages and of dropped batches of guests, by their origin."""
        counts = self._malformed
        if self._packets is not None:
            counts = counts | {_INTERFACES: self._packets.malformed}
        malformed = {name: each.count for name, each in counts.items() if each.count}
        return {"malformed": malformed, "dropped_batches": dict(self._intake.dropped)}

    def close(self) -> None:
        """End the session and the logs; harmless when repeated."""
        self._transport.close()
        self._service.close()

    def advance(self, request: Advance, answer: Callable[[Advanced], None] = lambda _: None) -> bool:
        """Simulate the interval of an `Advance`, reply, and deliver; or reply with the missing senders.

        Returns False with missing senders: the request is repeated. The reply is sent first, so that the time
        master continues; vehicles wait for announced deliveries.

        Raises ValueError for an invalid request.
        """
        missing = self._take_in(request)
        if missing:
            answer(self._service.advanced(missing=tuple(sorted(missing))))
            return False
        self._intake.begin_interval()
        advance = self._service.advance if self._packets is None else self._packets.advance
        batches = advance(request)
        delivered = sorted(batches.keys() & self._senders.keys())
        answer(self._service.advanced(delivered=tuple(delivered)))
        # the first vehicles may share this processor and cannot run before the end of this loop
        for station in reversed(delivered):
            self._send(self._senders[station], batches.pop(station))
        for station, batch in batches.items():
            self._askers[station].ask(encode(batch))  # without waiting for the reply
        return True

    def _take_in(self, request: Advance) -> set[Station]:
        """Collect the vehicles' batches; return the senders whose batches are missing."""
        missing = self._service.missing(request)
        while (payload := self._transmissions.take(BATCH_LIMIT_S if missing else 0.0)) is not None:
            batch = self._submit(payload)
            if batch is not None and batch.now_us == request.at_us and not batch.more:
                missing.discard(batch.station)
        return missing

    def _send(self, sender: TopicSender, batch: RxBatch) -> None:
        for piece in in_pieces(batch):
            sender.send(encode(piece))

    def _submit(self, payload: bytes) -> TxBatch | None:
        """Decode a vehicle's batch and submit it; return None if it is invalid."""
        batch = decode(TxBatch, payload)
        if batch is None or self._service.is_guest(batch.station) or not self._service.submit(batch):
            self._malformed[_VEHICLES].add(len(payload))
            self._influence(FOREIGN)  # vehicles send no such messages
            return None
        return batch

    def _influence(self, cause: str) -> None:
        if cause not in self._influences:
            self._influences.add(cause)
            self._on_influence(cause)

    def _on_declared(self, question: Question) -> None:
        """Reply to a vehicle's empty batch, which follows its declarations."""
        batch = decode(TxBatch, question.payload)
        if batch is None or batch.items or not 0 <= batch.station < self._vehicles:
            self._malformed[_VEHICLES].add(len(question.payload))
            self._influence(FOREIGN)
            question.drop()
        else:
            question.answer(_ACK)

    def _on_guest(self, question: Question) -> None:
        """Submit a guest's batch, unless it is invalid or exceeds the interval's limit."""
        station = self._by_key.get(question.key)  # the router accepts it of this guest and of vehicles alone
        if station is None:
            self._malformed[_VEHICLES].add(len(question.payload))
            self._influence(FOREIGN)
            question.drop()
            return
        if self._intake.is_full(station):
            self._intake.refuse(station)
            question.answer(_FULL)
            return
        size = len(question.payload)
        batch = decode(TxBatch, question.payload) if size <= LONGEST_GUEST_BATCH_BYTES else None
        if batch is None or batch.station != station:
            self._malformed[self._intake.names[station]].add(size)
            question.drop()
            return
        is_accepted = self._intake.accept(station, len(batch.items))
        if is_accepted and batch.items:
            self._influence(GUEST)  # its traffic is not a function of scenario and seed
            self._service.submit(batch)
        question.answer(_ACK if is_accepted else _FULL)

    def _on_directory(self, question: Question) -> None:
        if decode(DirectoryRequest, question.payload) is None:
            self._malformed[_DIRECTORY].add(len(question.payload))
            question.drop()
            return
        question.answer(self._directory)


_ACK, _FULL = encode(Ack()), encode(Ack(full=True))
_VEHICLES, _DIRECTORY, _INTERFACES = "vehicles", "directory", "interfaces"
"""Origins of messages beside the guests."""


def _repetition(
    request: Advance, clock: MessageStream[Advanced, Advance], later: deque[Advance]
) -> Advance | None:
    """Return the repetition of a request, None at the stream's end; requests before it go to ``later``."""
    while (other := clock.receive()) is not None and other.to_us != request.to_us:
        later.append(other)
    return other


def _endpoint(config: ServerConfig) -> str:
    if config.socket_path is not None:
        return unix_endpoint(config.socket_path)
    return f"tcp/{config.host}:{config.port}"


def _shares_a_processor() -> bool:
    """Whether this process is bound to one processor, which it shares with vehicles.

    An unbound process does not yield, since other processes of the machine would take the time.
    """
    return sys.platform == "linux" and len(os.sched_getaffinity(0)) == 1


def run(config_path: Path, interval_fd: int, *, supervised: bool) -> None:
    """Serve with the settings of a configuration file until the time master closes its socket.

    Raises TransportError, OSError, or ValueError (also as msgspec.DecodeError).
    """
    with contextlib.ExitStack() as stack:
        clock = emulators_end(stack.enter_context(socket.socket(fileno=interval_fd)))
        config = msgspec.json.decode(config_path.read_bytes(), type=ServerConfig)
        if config.packets:  # the channel will follow wall time, and loading a kernel takes milliseconds
            warm_up()
            end_waits_on_time()
        server = Server(config, on_influence=lambda cause: emit(Influenced(name="radio", by=cause)))
        stack.enter_context(contextlib.closing(server))
        inbox: queue.SimpleQueue[Stop] = queue.SimpleQueue()
        if supervised:
            commands(Stop, inbox)
        # existing objects are permanent: exclude them from garbage collection
        gc.collect()
        gc.freeze()
        emit(Ready(name="radio", pid=os.getpid(), details={"endpoint": server.endpoint}))
        with profiled(
            PROFILE_GROUPS, now_us=lambda: server.reached_us, from_us=config.profile_from_us
        ) as profile:
            details = server.serve(clock)
        if supervised:
            inbox.get()  # stay until the stop command, so that clients can end
    emit(Finished(name="radio", details=details | profile))

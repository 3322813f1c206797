"""The process that hosts interfaces and programs of vehicles: PID 1 of their namespace.

One thread waits for packet sockets, commands, ended programs and MAVLink of ``eth0``. What packet sockets
hold is sent in few messages. Received packets are written to the interfaces in Zenoh's thread as they arrive:
waking another thread takes longer than the delivery.
"""

import contextlib
import gc
import logging
import os
import resource
import selectors
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
from foundation.processes.wakeable_queue import WakeableQueue
from netsim.network.autopilot_relay import AutopilotRelay, Flow, Vehicle
from netsim.network.bridge import Bridge
from netsim.network.messages import NAME, Command, NetworkConfig, StartPrograms, check
from netsim.network.packet_socket import PacketSocket
from netsim.network.programs import Programs
from netsim.network.tap_file import TapFile
from netsim.network.vehicle_networks import VehicleNetwork, make_networks
from netsim.transport.access_control import User
from netsim.transport.lockstep_radio import packets_received_key, packets_sent_key
from netsim.transport.malformed import MalformedCount
from netsim.transport.zenoh_session import LONGEST_DIRECT_BYTES, Transport, TransportError
from netsim.wire.messages import Station
from netsim.wire.packets import (
    MAX_PACKET_BYTES,
    PacketCounts,
    SentPacket,
    SentPackets,
    decode_received,
    encode_packets,
)

MOST_PACKETS = LONGEST_DIRECT_BYTES // (MAX_PACKET_BYTES + 64)
"""Most packets of a message, so that packets of greatest length with their fields fit."""
FRAMES_PER_TURN = 16
"""Most frames that are read from a station before the others have their turn."""
DESCRIPTORS_OF_VEHICLE, DESCRIPTORS_BESIDE = 8, 128
"""Descriptors of a vehicle: two namespaces, two of ``wlan0``, three sockets of ``eth0`` and one of another
port; and of everything else."""
EMULATOR_LIMIT_S = 20.0
"""Wall time within which the emulator's declaration has to arrive."""

logger = logging.getLogger(__name__)


class BridgedInterfaces:
    """Packet sockets of all vehicles and the bridge, for two threads.

    ``publish`` sends the bytes of a message to the emulator. The owner of ``selector`` calls `read` with the
    stations whose sockets are ready, which are the keys' data, and `end`. The other thread calls `deliver`;
    it shares no changing state with the first.
    """

    def __init__(
        self,
        sockets: Mapping[Station, PacketSocket | TapFile],
        *,
        window_packets: int,
        selector: selectors.BaseSelector,
        publish: Callable[[bytes], None],
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._sockets, self._selector, self._publish, self._clock_ns = sockets, selector, publish, clock_ns
        self._bridge = Bridge(sockets, window_packets=window_packets)
        self._malformed = MalformedCount("message of received packets")
        for station in sockets:
            self._watch(station)

    def read(self, ready: Sequence[Station]) -> None:
        """Send what the sockets of these stations hold, at most `FRAMES_PER_TURN` frames of each."""
        batch: list[SentPacket] = []
        for station in ready:
            batch += self._read(station)
            while len(batch) >= MOST_PACKETS:
                self._send(batch[:MOST_PACKETS])
                del batch[:MOST_PACKETS]
        if batch:
            self._send(batch)

    def deliver(self, payload: bytes) -> PacketCounts:
        """Deliver the packets of a message of the emulator; return its ended packets, for `end`.

        Counts bytes that are no message.
        """
        message = decode_received(payload)
        if message is None:
            self._malformed.add(len(payload))
            return ()
        for station, frame in self._bridge.receive(message, self._clock_ns()):
            self._sockets[station].write(frame)
        return message.ended

    def end(self, ended: PacketCounts) -> None:
        """Take packets out of the windows, and read the interfaces whose windows have room again."""
        for station in self._bridge.end(ended):
            self._watch(station)

    @property
    def counters(self) -> dict[str, object]:
        """Return the bridge's counters, and those of sockets and messages."""
        return self._bridge.counters | {
            "kernel_drops": {i: each.kernel_drops for i, each in self._sockets.items() if each.kernel_drops},
            "undelivered_frames": sum(each.undelivered for each in self._sockets.values()),
            "malformed_messages": self._malformed.count,
        }

    def _read(self, station: Station) -> Iterator[SentPacket]:
        frames, bridge = self._sockets[station], self._bridge
        for _ in range(FRAMES_PER_TURN):
            if not bridge.is_open(station):
                self._selector.unregister(frames)
                return
            frame = frames.read()
            if frame is None:
                return
            packet = bridge.accept(station, frame, self._clock_ns())
            if packet is not None:
                yield packet

    def _watch(self, station: Station) -> None:
        with contextlib.suppress(KeyError):  # it is watched: the window was full between two turns only
            self._selector.register(self._sockets[station], selectors.EVENT_READ, station)

    def _send(self, packets: Sequence[SentPacket]) -> None:
        self._publish(encode_packets(SentPackets(packets=tuple(packets))))


class Host:
    """Interfaces, programs and the emulator's messages; `serve` returns after a command to stop.

    Raises TransportError if the emulator does not accept packets.
    """

    def __init__(
        self, config: NetworkConfig, networks: Sequence[VehicleNetwork], transport: Transport,
        inbox: WakeableQueue[Command],
    ) -> None:  # fmt: skip
        self._inbox = inbox
        self._ended: WakeableQueue[PacketCounts] = WakeableQueue()
        self._selector = selectors.DefaultSelector()
        self._programs = Programs(
            config.programs, {each.station: each.namespaces for each in networks}, report=emit
        )
        sender = transport.sender(packets_sent_key(config.run_id))
        if not sender.wait_for_receiver(EMULATOR_LIMIT_S):
            raise TransportError(f"{config.endpoint}: the 802.11 emulator does not accept packets")
        self._interfaces = BridgedInterfaces(
            {each.station: each.frames for each in networks},
            window_packets=config.window_packets,
            selector=self._selector,
            publish=sender.send,
        )
        transport.subscribe(packets_received_key(config.run_id), self._on_received)
        companions = {each.station: each.companion for each in networks if each.companion is not None}
        self._relay = AutopilotRelay(
            [(each, companions[each.station]) for each in config.companions if each.station in companions],
            self._selector,
            time.monotonic,
        )
        self.companion_ports = self._relay.companion_ports
        self._child_ended = _child_signals()
        for source in (self._ended, self._inbox, self._child_ended):
            self._selector.register(source, selectors.EVENT_READ)

    def serve(self) -> dict[str, Any]:
        """Bridge packets and run programs until all have ended after a command to stop; return counters."""
        while not self._programs.have_ended:
            keys = [key for key, _ in self._selector.select(self._timeout_s())]
            self._interfaces.read([key.data for key in keys if isinstance(key.data, int)])
            for ended in self._ended.take_all():
                self._interfaces.end(ended)
            for key in keys:
                if isinstance(key.data, Flow | Vehicle):
                    key.data.read()
            if any(key.fd == self._child_ended for key in keys):
                os.read(self._child_ended, 4_096)
            for command in self._inbox.take_all():
                self._on_command(command)
            self._programs.update(time.monotonic())
            self._relay.update(time.monotonic())
        return {
            "bridge": self._interfaces.counters,
            "programs": self._programs.counters,
            "autopilot_links": self._relay.counters,
        }

    def _on_received(self, payload: bytes) -> None:
        """Deliver a message of the emulator, in Zenoh's thread."""
        ended = self._interfaces.deliver(payload)
        if ended:
            self._ended.put(ended)

    def _timeout_s(self) -> float | None:
        due_s = [each for each in (self._programs.wall_due_s, self._relay.wall_due_s) if each is not None]
        return max(min(due_s) - time.monotonic(), 0.0) if due_s else None

    def _on_command(self, command: Command) -> None:
        wall_s = time.monotonic()
        match command:
            case StartPrograms():
                for index in self._programs.start(command.programs, wall_s):
                    logger.warning("there is no program %d", index)
            case Stop():
                self._programs.stop(wall_s)


def run(config_path: Path, outer_proc: int, *, pid: int, supervised: bool) -> None:
    """Serve with the settings of a configuration file; without a supervisor programs start at once.

    ``pid`` is this process's parent, by which the supervisor names it. Raises NetworksNotMade,
    TransportError, OSError, or ValueError (also as msgspec.DecodeError).
    """
    config = msgspec.json.decode(config_path.read_bytes(), type=NetworkConfig)
    check(config)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a program could send it; the end comes as a command
    _allow_descriptors(DESCRIPTORS_OF_VEHICLE * len(config.stations))
    companions = {each.station for each in config.companions}
    # before there are other threads
    networks = make_networks(config.stations, companions, outer_proc, config.interfaces)
    inbox: WakeableQueue[Command] = WakeableQueue()
    transport = Transport.connect(config.endpoint, User(config.user, config.password), direct=True)
    with contextlib.closing(transport):
        host = Host(config, networks, transport, inbox)
        if supervised:
            commands(Command, inbox)  # type: ignore[arg-type]  # a union of types
        else:
            inbox.put(StartPrograms())
        gc.collect()
        gc.freeze()  # what exists is permanent
        holders = {str(each.station): each.holder_pid for each in networks}
        details = {"holders": holders, "companion_ports": host.companion_ports}
        emit(Ready(name=NAME, pid=pid, details=details))
        details = host.serve()
    emit(Finished(name=NAME, details=details))


def _allow_descriptors(number: int) -> None:
    """Raise the limit of descriptors as far as the system allows; one that is missing is an error later."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = DESCRIPTORS_BESIDE + number
    if soft != resource.RLIM_INFINITY and soft < needed:
        most = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _child_signals() -> int:
    """Return a descriptor that becomes readable with every SIGCHLD."""
    reader, writer = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)  # a handler, or the signal is ignored
    return reader

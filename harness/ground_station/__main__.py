"""``python -m harness.ground_station --config FILE``: the process of one ground station.

It has a UDP socket for each vehicle, as vehicles have with telemetry by wire. What a program sends there is
given to the serial modem at once, to the radio as far as it holds few frames (`send_window`), and is on the
air in the next interval of simulated time. What the radio receives from the vehicle is sent to the default
program and to all that have sent to the socket.
"""

import argparse
import contextlib
import os
import selectors
import sys
from pathlib import Path
from typing import Any

import msgspec

from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.partners import Partners
from autopilot.mavlink.udp_socket import Address, UdpSocket
from foundation.processes.child_protocol import Finished, Influenced, Ready, Stop, Warned, commands, emit
from foundation.processes.prefork import show_name
from foundation.processes.socket_owners import DatagramOwners
from foundation.processes.wakeable_queue import WakeableQueue
from harness.ground_station.relay import Relay
from harness.ground_station.serial_relay import SerialRelay
from harness.ground_station.settings import GroundStationConfig
from netsim.transport.access_control import User
from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.lockstep_radio import RadioFull
from netsim.transport.zenoh_session import Transport
from netsim.wire.messages import MOST_GUEST_ITEMS, RxBatch

MAX_DATAGRAMS_PER_CALL = 64
"""Datagrams that are read of one socket before the others are looked at."""
RETRY_S = 0.5
"""Wall time after which an unreachable default program is sent to again."""
_US_PER_S = 1_000_000


class ProgramSocket:
    """The socket of one vehicle: programs that send to it, and those that are sent to."""

    def __init__(self, udp: UdpSocket) -> None:
        self.udp = udp
        self._partners: Partners[Address, None] = Partners(udp.defaults, lambda: None)
        self._budget = InputBudget()
        self._wall_retry_s = 0.0
        """Time before which the default program, being unreachable, is not sent to."""
        self.foreign: Address | None = None
        """The first sender whose datagrams were dropped because of their owner."""
        self.counts = {"datagrams_foreign": 0, "datagrams_over_budget": 0}

    def receive(self, now_us: int) -> list[bytes]:
        """Return the datagrams of trusted programs, up to a limit; ``now_us`` is simulated time."""
        wall_s, found = self.udp.wall_s(), []
        self._budget.advance(now_us, round(wall_s * _US_PER_S))
        for _ in range(MAX_DATAGRAMS_PER_CALL):
            received = self.udp.receive()
            if received is None:
                break
            data, address = received
            if not self.udp.trusts(address, wall_s):
                self.counts["datagrams_foreign"] += 1
                self.foreign = self.foreign or address
            elif not self._budget.admits(address):
                self.counts["datagrams_over_budget"] += 1
            else:
                self._budget.spend(address, 1)
                self._partners.add(address)
                found.append(data)
        return found

    def send(self, datagram: bytes) -> None:
        """Send a datagram to all programs."""
        wall_s = self.udp.wall_s()

        def may_send(address: Address, /, *, has_sent: bool) -> bool:
            is_due = has_sent or wall_s >= self._wall_retry_s
            return is_due and self.udp.may_send(address, wall_s, has_sent=has_sent)

        for address in self._partners.recipients(may_send):
            self.udp.send(datagram, address)
        for address in self.udp.take_unreachable(look=True):
            self._partners.remove(address)
            if address in self.udp.defaults:
                self._wall_retry_s = wall_s + RETRY_S


class GroundStation:
    """The sockets of a ground station and its radio, which are opened with the process's resources."""

    def __init__(self, config: GroundStationConfig, stack: contextlib.ExitStack) -> None:
        self._config = config
        self._relay = _relay(config)
        self._now_us = 0
        """Simulated time up to which the radio has returned deliveries."""
        self._received: WakeableQueue[RxBatch] = WakeableQueue()
        owners = DatagramOwners(config.host) if config.local_senders == "own" else None
        default = (config.remote_host, config.remote_port) if config.remote_port else None
        self._sockets = [
            ProgramSocket(
                stack.enter_context(
                    contextlib.closing(UdpSocket(config.host, port, default=default, owners=owners))
                )
            )
            for port in config.local_ports
        ]
        transport = Transport.connect(config.endpoint, User(config.user, config.password))
        stack.callback(transport.close)
        self._radio = AsynchronousRadio(
            transport,
            run_id=config.run_id,
            station=config.station,
            put=self._received.put,
            answer_limit_s=config.answer_limit_s,
        )
        self._is_influenced = self._has_warned = False

    def run(self, inbox: WakeableQueue[Stop]) -> None:
        """Relay until a command arrives; emits `Ready` and `Finished`. Raises RadioLost."""
        config = self._config
        ports = [each.udp.local_port for each in self._sockets]
        details = {"station": config.station, "gcs_local_udp": ports, "gcs_remote_udp": config.remote_port}
        with selectors.DefaultSelector() as selector:
            selector.register(inbox, selectors.EVENT_READ)
            selector.register(self._received, selectors.EVENT_READ)
            for vehicle, each in enumerate(self._sockets):
                selector.register(each.udp, selectors.EVENT_READ, vehicle)
            emit(Ready(name=config.name, pid=os.getpid(), details=details))
            while not inbox.take_all():
                ready = [key.data for key, _ in selector.select() if key.data is not None]
                self._send_to_programs()
                self._send_to_vehicles(ready)
        emit(Finished(name=config.name, details=self._counts()))

    def _send_to_programs(self) -> None:
        for batch in self._received.take_all():
            self._now_us = batch.release_us
            for vehicle, datagram in self._relay.datagrams(batch):
                self._sockets[vehicle].send(datagram)

    def _send_to_vehicles(self, vehicles: list[int]) -> None:
        """Give the radio what programs have sent to the sockets of these vehicles, and what has waited."""
        for vehicle in vehicles:
            for datagram in self._sockets[vehicle].receive(self._now_us):
                self._relay.put(vehicle, datagram)
            self._warn_of_foreign(self._sockets[vehicle].foreign)
        frames: list[Any] = [*self._relay.take()]  # of the relay's kind
        if not frames:
            return
        if not self._is_influenced:
            self._is_influenced = True
            emit(Influenced(name=self._config.name, by="a program over UDP"))
        try:
            self._radio.hand_over(frames)
        except RadioFull:
            self._relay.on_refused(frames)

    def _warn_of_foreign(self, foreign: Address | None) -> None:
        if foreign is None or self._has_warned:
            return
        self._has_warned = True
        text = (
            f"MAVLink from {foreign[0]}:{foreign[1]} is dropped: its sender has ended or is of another user "
            "(links.local_senders)"
        )
        emit(Warned(name=self._config.name, time_us=self._now_us, text=text))

    def _counts(self) -> dict[str, object]:
        counts = [each.counts | {"datagrams_over_buffer": each.udp.dropped} for each in self._sockets]
        rejected = {name: sum(each[name] for each in counts) for name in counts[0]}
        return {
            "serial" if self._config.serial_modems else "frames": self._relay.counts,
            **rejected,
            **self._relay.dropped,
            "malformed_deliveries": self._radio.malformed,
        }


def _relay(config: GroundStationConfig) -> Relay | SerialRelay:
    vehicles = len(config.local_ports)
    if config.serial_modems:
        return SerialRelay(vehicles)
    return Relay(
        vehicles,
        # what the emulator takes while simulated time rests is limited too
        queue_frames=min(config.queue_frames, MOST_GUEST_ITEMS),
        queue_lifetime_us=config.queue_lifetime_us,
    )


def main() -> int:
    """Relay until a command to stop; return 2, after one line on stderr, if it fails."""
    parser = argparse.ArgumentParser(
        prog="python -m harness.ground_station", description="One ground station on the emulated channel."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the settings")
    parser.add_argument("--supervised", action="store_true", help="read commands on stdin; exit at its end")
    given = parser.parse_args()
    try:
        config = msgspec.json.decode(given.config.read_bytes(), type=GroundStationConfig)
        show_name(config.name.replace(" station", "", 1))  # 8 characters of the station's name remain
        inbox: WakeableQueue[Stop] = WakeableQueue()
        if given.supervised:
            commands(Stop, inbox)
        with contextlib.ExitStack() as stack:
            GroundStation(config, stack).run(inbox)
    except (OSError, ValueError) as error:  # also an emulator that has ended; invalid settings
        print(f"ground station: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""``python -m autopilot.process.companion --config FILE``: the on-board application beside a PX4.

The application is connected to PX4 as a companion over UDP (14540+i to 14580+i), and to the run's radio. Its
clock is PX4's, which the simulator sets: time advances with PX4's messages and stops without them. With the
application disabled it serves the radio alone and does not open the UDP port.
"""

import argparse
import contextlib
import gc
import os
import queue
import select
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.logs.companion_record import CompanionLog
from autopilot.mavlink.codec import Encoder, Message, Parser, stamp
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.onboard.application import NOTHING, Application
from autopilot.onboard.factory import make_application
from autopilot.onboard.formation.messages import heartbeat
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import VehicleConfig
from autopilot.process.companion_radio import CompanionRadio
from autopilot.process.warm_up import warm_up
from autopilot.services.status import Chunks
from foundation.kernels.warm_up import WarmUpError
from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
from netsim.wire.messages import RxItem, TxItem

TICK_US = 8_000
"""Least time between two updates of the application: PX4's fastest stream is ATTITUDE at 100 Hz, in steps of
4 ms."""
LONGEST_LEAP_US = 60_000_000
"""Largest advance of PX4's clock by one message; a larger one must be confirmed by a second message."""
ORIGIN_PERIOD_US = 1_000_000
"""Period of requests for the estimator's origin, which PX4 does not stream to a companion."""
ORIGIN_KNOWN_PERIOD_US = 10_000_000
CALL_PERIOD_S = 1.0
"""Wall time without a message after which a heartbeat is sent: PX4 answers the first sender."""
_POLL_S = 0.2
_MOST_WAITING = 1_000
"""Datagrams that are read before the application is updated; a socket holds some hundreds."""
_US_PER_MS = 1_000
_LARGEST_DATAGRAM_BYTES = 65_535
_TIMED = frozenset(
    {
        common.MAVLINK_MSG_ID_ATTITUDE,
        common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    }
)
"""Messages whose time_boot_ms sets the clock."""
_REPORTED = frozenset({common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_NAMED_VALUE_INT})
"""Messages that are reported to the simulator: the application's phase and start, PX4's mode."""


class CompanionOutput(Struct, frozen=True, kw_only=True):
    """Messages that one update of the application sends."""

    mavlink: Sequence[Message] = ()
    """To PX4; each carries its source."""
    radio: tuple[TxItem, ...] = ()
    said: Sequence[Message] = ()
    """Reports to the simulator."""


class Companion:
    """The application and its protocol with a PX4. Does no I/O.

    Attributes:
        now_us: PX4's clock, which is the simulation's; -1 before the first message.

    """

    def __init__(self, config: VehicleConfig) -> None:
        self.now_us = -1
        self._system = config.instance + 1
        self.app: Application = make_application(config)
        self._stamp_us = -1
        """Time of the last timed message, whether it was accepted or not."""
        self._tick_us = 0
        self._origin_us = 0
        self._has_origin = False
        self._replies: list[Message] = []
        self._reports: list[Message] = []
        self._chunks = Chunks()

    @property
    def is_due(self) -> bool:
        """Whether `on_timer` is due."""
        return self.now_us >= self._tick_us

    def on_message(self, message: Message) -> None:
        """Handle a message from PX4's link; messages of others only if they target this application."""
        kind = message.get_msgId()
        if message.get_srcSystem() == self._system and message.get_srcComponent() == AUTOPILOT_COMPONENT:
            if kind in _TIMED:
                self._update_clock(message.time_boot_ms * _US_PER_MS)
            if self.now_us < 0:
                return
            self.app.on_mavlink(message, self.now_us)
            if kind == common.MAVLINK_MSG_ID_HEARTBEAT:
                self._reports.append(message)
            elif kind == common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                self._has_origin = True
        elif (
            getattr(message, "target_system", None) == self._system
            and getattr(message, "target_component", None) == APPLICATION_COMPONENT
        ):
            self._replies += self.app.on_request(message)

    def _update_clock(self, boot_us: int) -> None:
        """Advance the clock. It never goes back; a large advance must agree with the previous message."""
        before_us, self._stamp_us = self._stamp_us, boot_us
        agrees = any(boot_us - LONGEST_LEAP_US <= seen_us <= boot_us for seen_us in (self.now_us, before_us))
        if self.now_us < 0 or (boot_us > self.now_us and agrees):
            self.now_us = boot_us

    def on_timer(self, radio_items: Sequence[RxItem]) -> CompanionOutput:
        """Update the application with the items that its radio has received."""
        now_us = self.now_us
        self._tick_us = now_us + TICK_US
        self.app.on_radio(radio_items, now_us)
        output = self.app.on_timer(now_us)
        requested: list[Message] = []
        for item in output.mavlink:
            if isinstance(item, PositionTarget):
                requested.append(item.to_wire())
            else:
                requested += self._chunks.split(item)
        mavlink, self._replies = [*self._replies, *requested], []
        if now_us >= self._origin_us:
            self._origin_us = now_us + (ORIGIN_KNOWN_PERIOD_US if self._has_origin else ORIGIN_PERIOD_US)
            mavlink.append(
                common.MAVLink_command_long_message(
                    self._system, AUTOPILOT_COMPONENT, common.MAV_CMD_REQUEST_MESSAGE, 0,
                    float(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                )
            )  # fmt: skip
        for message in mavlink:
            stamp(message, system=self._system, component=APPLICATION_COMPONENT)
        reports, self._reports = self._reports, []
        reports += [message for message in mavlink if message.get_msgId() in _REPORTED]
        radio = () if output is NOTHING else output.radio
        return CompanionOutput(mavlink=mavlink, radio=radio, said=reports)

    def call(self) -> Message:
        """Return a heartbeat without content, which makes PX4 send to this address."""
        (beat,) = heartbeat(FlightPhase.WAITING, None, 0)
        return stamp(beat, system=self._system, component=APPLICATION_COMPONENT)


class CompanionProcess:
    """A companion with its sockets."""

    def __init__(self, config: VehicleConfig, stack: contextlib.ExitStack) -> None:
        self._name = f"application {config.instance}"
        ports = config.ports
        if ports.radio_endpoint is None:
            raise ValueError("ports.radio_endpoint: missing; the application beside a PX4 requires a radio")
        self._companion: Companion | None = None
        self._socket: socket.socket | None = None
        self._log: CompanionLog | None = None
        if config.onboard.enabled:
            self._companion = Companion(config)
            if config.log_path is not None:
                self._log = stack.enter_context(
                    contextlib.closing(CompanionLog(config, config.log_path, self._companion.app))
                )
            self._socket = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._socket.bind((ports.host, ports.companion_remote_udp))
            # a connected socket accepts datagrams from PX4 alone
            self._socket.connect((ports.host, ports.companion_local_udp))
            self._socket.settimeout(0.0)  # non-blocking
        self._radio = stack.enter_context(
            contextlib.closing(
                CompanionRadio(endpoint=ports.radio_endpoint, run_id=config.run_id, station=config.instance)
            )
        )
        self._parser = Parser()
        self._encoder = Encoder(system=config.instance + 1, component=APPLICATION_COMPONENT)
        self._message_count = 0

    def run(self, inbox: "queue.SimpleQueue[Stop]") -> None:
        """Run until stopped. Raises WarmUpError."""
        if self._companion is not None:
            # PX4 does not wait for the application: kernels loaded in flight would interrupt its setpoints
            warm_up()
        emit(Ready(name=self._name, pid=os.getpid()))
        # existing objects live to the end: exempt them from garbage collections in flight
        gc.collect()
        gc.freeze()
        if self._companion is None or self._socket is None:
            inbox.get()
        else:
            self._work(self._companion, self._socket, inbox)
        details: dict[str, object] = {
            "autopilot_messages": self._message_count,
            "malformed_bytes": self._parser.bad_bytes,
            "malformed_deliveries": self._radio.malformed,
        }
        if self._companion is not None:
            details |= self._companion.app.troubles()
        emit(Finished(name=self._name, details=details))

    def _work(self, companion: Companion, link: socket.socket, inbox: "queue.SimpleQueue[Stop]") -> None:
        silent_s = CALL_PERIOD_S
        while inbox.empty():
            if silent_s >= CALL_PERIOD_S:
                silent_s = 0.0
                self._send(link, [companion.call()])
            if not select.select([link], [], [], _POLL_S)[0]:
                silent_s += _POLL_S
                continue
            # after a delay there is one update with the newest messages, not one for each
            for _ in range(_MOST_WAITING):
                try:
                    self._take(companion, link.recv(_LARGEST_DATAGRAM_BYTES))
                    silent_s = 0.0
                except OSError:  # no more data, or PX4 does not listen yet
                    break
            if companion.is_due:
                self._update(companion, link)

    def _take(self, companion: Companion, datagram: bytes) -> None:
        for message in self._parser.push_datagram(datagram):
            self._message_count += 1
            companion.on_message(message)
            if self._log is not None:
                self._log.on_message(message)

    def _update(self, companion: Companion, link: socket.socket) -> None:
        now_us = companion.now_us
        output = companion.on_timer(self._radio.receive(now_us))
        if output.mavlink:
            self._send(link, output.mavlink)
        if output.radio:
            self._radio.send(now_us, output.radio)
        self._radio.report(output.said)
        if self._log is not None:
            self._log.write(now_us)

    def _send(self, link: socket.socket, messages: Sequence[Message]) -> None:
        with contextlib.suppress(OSError):  # lost, or PX4 does not listen yet
            link.send(b"".join(map(self._encoder.encode, messages)))


def main() -> int:
    """Parse the command line and run; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m autopilot.process.companion", description="The on-board application beside one PX4."
    )
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the vehicle's settings")
    parser.add_argument(
        "--supervised", action="store_true", help="exit on a command on stdin, or when it is closed"
    )
    arguments = parser.parse_args()
    inbox: queue.SimpleQueue[Stop] = queue.SimpleQueue()
    try:
        config = msgspec.json.decode(arguments.config.read_bytes(), type=VehicleConfig)
        if arguments.supervised:
            commands(Stop, inbox)
        with contextlib.ExitStack() as stack:
            CompanionProcess(config, stack).run(inbox)
    except (OSError, ValueError, WarmUpError) as error:
        sys.stderr.write(f"application: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())

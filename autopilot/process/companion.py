"""The process of an application beside another autopilot, forked by `autopilot.process.prefork_server`.

The autopilot is a PX4 or an ArduPilot. The application is connected to it as a companion over UDP (14540+i),
to the run's radio, and to the simulator, which requests the iterations of its loop
(`autopilot.process.iteration`). The autopilot's clock is the simulator's, so its messages rest while
simulated time rests: they wait in the socket for the next iteration. Its texts are written to stderr.
"""

import argparse
import contextlib
import gc
import os
import queue
import socket
import sys
import traceback
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec
from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.logs.companion_record import CompanionLog
from autopilot.mavlink.codec import Message, Parser, stamp
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.mavlink.telemetry import CompanionEncoder
from autopilot.onboard.factory import make_programs
from autopilot.onboard.programs import NOTHING, Programs
from autopilot.parameters.config import VehicleConfig
from autopilot.process.autopilot_socket import AutopilotSocket, sender_check
from autopilot.process.iteration import APPLICATION, Iterate, Iterated
from autopilot.process.streams import ARDUPILOT_STREAMS, PX4_STREAMS, Streams
from autopilot.services.status import Chunks
from foundation.extension_call import end_stuck, watched
from foundation.extension_failure import ExtensionFailure
from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
from foundation.processes.message_stream import MessageStream
from foundation.processes.scheduling import yield_when_woken
from netsim.transport.lockstep_radio import RadioClient
from netsim.wire.messages import RxItem, TxItem

ORIGIN_PERIOD_US = 1_000_000
"""Period of requests for the estimator's origin, which is not streamed to a companion."""
ORIGIN_KNOWN_PERIOD_US = 10_000_000
_PAUSED_S = 0.5
"""Wall time without a request after which the autopilot's messages are read anyway: simulated time rests."""
_REPORTED = frozenset({
    common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_NAMED_VALUE_INT,
    common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, common.MAVLINK_MSG_ID_STATUSTEXT,
})  # fmt: skip
"""Messages that are reported to the simulator: the application's status, the autopilot's mode."""


class CompanionOutput(Struct, frozen=True, kw_only=True):
    """Messages that one iteration of the application sends."""

    mavlink: Sequence[Message | PositionTarget] = ()
    """To the autopilot; each carries its source, except setpoints, which are the application's."""
    radio: tuple[TxItem, ...] = ()
    reports: Sequence[Message] = ()
    """To the simulator."""


class Companion:
    """The application and its protocol with the autopilot. Does no I/O; times are simulated."""

    def __init__(self, config: VehicleConfig) -> None:
        self._system = config.instance + 1
        self.app: Programs = make_programs(config)
        self._origin_us = 0
        self._has_origin = False
        is_px4 = config.autopilot.is_px4(config.instance)
        self._streams = Streams(
            PX4_STREAMS if is_px4 else ARDUPILOT_STREAMS, stops_others=is_px4, target_system=self._system
        )
        self._replies: list[Message] = []
        self._reports: list[Message] = []
        self._chunks = Chunks()

    def is_autopilots(self, message: Message) -> bool:
        """Whether a message is of the own autopilot; of plain values `TelemetryParser` checks the source."""
        return isinstance(message, tuple) or (
            message.get_srcSystem() == self._system and message.get_srcComponent() == AUTOPILOT_COMPONENT
        )

    def on_message(self, message: Message, now_us: int) -> None:
        """Handle a message on the autopilot's link; of others only those to this application."""
        if self.is_autopilots(message):
            kind = message.get_msgId()
            self.on_kind(kind, now_us)
            if not self._streams.is_used(kind):
                return
            self.app.on_mavlink(message, now_us)
            if kind == common.MAVLINK_MSG_ID_HEARTBEAT:
                self._reports.append(message)
            elif kind == common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                self._has_origin = True
        elif self.is_request(message):
            self._replies += self.app.on_request(message)

    def is_request(self, message: Message) -> bool:
        """Whether a message targets this application."""
        return (
            getattr(message, "target_system", None) == self._system
            and getattr(message, "target_component", None) == APPLICATION_COMPONENT
        )

    def on_kind(self, kind: int, now_us: int) -> None:
        """Process the arrival of a message of the autopilot, known or unknown; one not used is stopped."""
        self._replies += self._streams.on_message(kind, now_us)

    def on_timer(self, radio_items: Sequence[RxItem], now_us: int) -> CompanionOutput:
        """Run the iteration that begins at ``now_us`` with the items that the radio has received."""
        self.app.on_radio(radio_items, now_us)
        output = self.app.on_timer(now_us)
        mavlink: list[Message | PositionTarget] = [*self.replies(), *self._streams.on_timer(now_us)]
        for item in output.mavlink:
            mavlink += (item,) if isinstance(item, PositionTarget) else self._chunks.split(item)
        if now_us >= self._origin_us:
            self._origin_us = now_us + (ORIGIN_KNOWN_PERIOD_US if self._has_origin else ORIGIN_PERIOD_US)
            mavlink.append(
                common.MAVLink_command_long_message(
                    self._system, AUTOPILOT_COMPONENT, common.MAV_CMD_REQUEST_MESSAGE, 0,
                    float(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
                )
            )  # fmt: skip
        for message in mavlink:
            if not isinstance(message, PositionTarget):
                stamp(message, system=self._system, component=APPLICATION_COMPONENT)
        reports, self._reports = self._reports, []
        reports += [message for message in mavlink if message.get_msgId() in _REPORTED]
        radio = () if output is NOTHING else output.radio
        return CompanionOutput(mavlink=mavlink, radio=radio, reports=reports)

    def replies(self) -> list[Message]:
        """Return the answers to requests since the last call; each carries its source."""
        replies, self._replies = self._replies, []
        return [stamp(reply, system=self._system, component=APPLICATION_COMPONENT) for reply in replies]


class CompanionProcess:
    """A companion with its sockets. Raises OSError, ValueError, TransportError and RadioLost."""

    def __init__(self, config: VehicleConfig, simulator: socket.socket, stack: contextlib.ExitStack) -> None:
        self._name = f"application {config.instance}"
        ports = config.ports
        if (endpoint := ports.radio_endpoint) is None:
            raise ValueError("ports.radio_endpoint: missing; an application requires a radio")
        self._companion = Companion(config)
        self._log: CompanionLog | None = None
        if config.log_path is not None:
            self._log = stack.enter_context(
                contextlib.closing(CompanionLog(config, config.log_path, self._companion.app))
            )
        is_px4 = config.autopilot.is_px4(config.instance)
        checked = config.links.local_senders == "own"
        self._autopilot = stack.enter_context(
            contextlib.closing(
                AutopilotSocket(
                    (ports.host, ports.companion_remote_udp),
                    (ports.host, ports.companion_local_udp) if is_px4 else None,
                    system=config.instance + 1,
                    is_autopilot=sender_check(ports.host, config.instance) if checked else lambda *_: True,
                )
            )
        )
        self._radio = stack.enter_context(
            contextlib.closing(
                RadioClient(
                    endpoint=endpoint.locator,
                    password=endpoint.password,
                    run_id=config.run_id,
                    station=config.instance,
                )
            )
        )
        self._requests: MessageStream[Iterated, Iterate] = MessageStream(
            simulator, Iterate, limit_s=_PAUSED_S
        )
        self._encoder = CompanionEncoder(system=config.instance + 1, component=APPLICATION_COMPONENT)
        self._message_count = 0
        self._now_us = 0
        self._held: list[Message] = []
        """Messages of the autopilot that arrived while simulated time rested, after the last iteration."""

    def run(self, inbox: "queue.SimpleQueue[Stop]") -> None:
        """Serve the simulator until it closes its socket; then wait for the stop."""
        emit(Ready(name=self._name, pid=os.getpid()))
        # existing objects live to the end: exempt them from garbage collections in flight
        gc.collect()
        gc.freeze()
        while True:
            try:
                request = self._requests.receive()
            except TimeoutError:
                self._serve_while_paused()
                continue
            if request is None:
                break
            self._requests.send(self._iterate(request))
        self._radio.close()  # a radio that is not read would block the emulator
        inbox.get()
        emit(
            Finished(
                name=self._name,
                details={
                    "autopilot_messages": self._message_count,
                    "foreign_datagrams": self._autopilot.foreign_datagrams,
                    "malformed_bytes": self._autopilot.parser.bad_bytes,
                    "unknown_messages": self._autopilot.parser.counters.frames_unknown,
                    "malformed_deliveries": self._radio.malformed,
                    **self._companion.app.troubles(),
                },
            )
        )

    def _iterate(self, request: Iterate) -> Iterated:
        now_us = self._now_us = request.time_us
        held, self._held = self._held, []
        companion, log = self._companion, self._log
        for message in (*held, *self._waiting()):
            if log is not None and companion.is_autopilots(message):
                log.on_message(message, now_us)
            if message.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT:
                sys.stderr.write(f"{now_us * 1e-6:.2f} s: {message.text}\n")
            companion.on_message(message, now_us)
        for reading in Parser().push_datagram(request.readings) if request.readings else ():
            companion.app.on_mavlink(reading, now_us)
        for kind in self._autopilot.parser.take_unknown():
            companion.on_kind(kind, now_us)
        items = self._radio.receive(request.released_us) if request.released_us else ()
        output = companion.on_timer(items, now_us)
        if output.mavlink:
            self._send(output.mavlink)
        if output.radio:
            self._radio.send(now_us, output.radio)
        reports = b"".join(map(self._encoder.encode, output.reports))
        return Iterated(handed_over=bool(output.radio), reports=reports)

    def _serve_while_paused(self) -> None:
        """Answer requests of ground stations while simulated time rests."""
        for message in self._waiting():
            if self._companion.is_request(message):
                self._companion.on_message(message, self._now_us)
            else:
                self._held.append(message)
        replies = self._companion.replies()
        if replies:
            self._send(replies)

    def _waiting(self) -> list[Message]:
        """Return the messages that have arrived from the autopilot."""
        messages = self._autopilot.receive()
        self._message_count += len(messages)
        return messages

    def _send(self, messages: Sequence[Message | PositionTarget]) -> None:
        self._autopilot.send(b"".join(map(self._encoder.encode, messages)))


def main(arguments: Sequence[str]) -> int:
    """Parse a command line and run; a failure is one line on stderr and status 2."""
    parser = argparse.ArgumentParser(prog=APPLICATION, description="The application beside one autopilot.")
    parser.add_argument("--config", type=Path, required=True, help="JSON file with the vehicle's settings")
    parser.add_argument("--simulator-fd", type=int, required=True, help="stream socket to the simulator")
    parser.add_argument("--supervised", action="store_true", help="accepted for uniformity, no effect")
    given = parser.parse_args(arguments)
    inbox: queue.SimpleQueue[Stop] = queue.SimpleQueue()
    try:
        config = msgspec.json.decode(given.config.read_bytes(), type=VehicleConfig)
        commands(Stop, inbox)
        yield_when_woken()
        with contextlib.ExitStack() as stack:
            simulator = stack.enter_context(socket.socket(fileno=given.simulator_fd))
            stack.enter_context(watched(config.call_limit_s, on_stuck=partial(end_stuck, APPLICATION)))
            CompanionProcess(config, simulator, stack).run(inbox)
    except ExtensionFailure as error:
        traceback.print_exception(error)
        sys.stderr.write(f"{APPLICATION}: {error}\n")
        return 2
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{APPLICATION}: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    return 0

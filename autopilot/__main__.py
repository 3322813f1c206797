"""``python -m autopilot --instance 3``: the process of one UAV, and the only module of it that uses sockets.

It connects to the simulator as PX4 does (TCP, retrying until the port is open) or inherits the connection
from its launcher, connects to the run's radio, and opens its MAVLink links. Each HIL_SENSOR then causes one
step of the vehicle and one answer. While the simulator is silent, because simulated time is paused or slow,
messages on the links are still answered and heartbeats continue by wall clock. The process ends when the
simulator closes the connection.
"""

import argparse
import contextlib
import gc
import os
import select
import selectors
import socket
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from pymavlink.dialects.v20 import common

from foundation.kernels import cache_folder

if "--supervised" not in sys.argv:  # a supervised process has it from the launcher
    os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from autopilot.mavlink.codec import Message
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.signing import SigningKeyError
from autopilot.mavlink.udp_link import UdpLink
from autopilot.navigation import plan_file
from autopilot.navigation.plan_file import PlanFileError
from autopilot.navigation.site_plan import PlanError
from autopilot.parameters import parameter_file
from autopilot.parameters.config import AutopilotConfig, VehicleConfig, VehiclePorts
from autopilot.parameters.parameter_file import ParameterFileError
from autopilot.parameters.table import ParameterError
from autopilot.process.profile_groups import PROFILE_GROUPS
from autopilot.services.service import COMPANION, GROUND_STATION, Addressed, Partner
from autopilot.vehicle.host import Host, Links, warnings
from foundation.extension_call import end_stuck, watched
from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from foundation.processes.child_protocol import Finished, Influenced, Ready, Warned, emit, end_with_parent
from foundation.processes.scheduling import yield_when_woken
from foundation.processes.socket_owners import DatagramOwners
from foundation.profiling.profiler import profiled
from netsim.transport.lockstep_radio import RadioClient

RETRY_S = 0.1
LINK_PERIOD_US = 20_000
"""Period of polls of the links, at whole steps: two system calls that mostly find nothing."""
WALL_LINK_PERIOD_S = 0.1
"""The same by wall clock, since simulated time may be slow."""
SILENCE_S = 0.5
"""Wall time without messages after which the simulator is considered paused."""
HEARTBEAT_S = 1.0
"""Wall time after which a heartbeat is sent even if simulated time is paused: stations time out after 3 s."""
_SILENCE_MS = round(SILENCE_S * 1e3)
_LINK_NAMES = {GROUND_STATION: "ground_station", COMPANION: "companion"}
_PORT_NAMES = {GROUND_STATION: "gcs_local_udp", COMPANION: "companion_local_udp"}


class SimulatorUnreachable(ConnectionError):
    """The simulator cannot be reached; the text is one line."""


def connect_simulator(ports: VehiclePorts, wall_timeout_s: float) -> socket.socket:
    """Connect to the simulator, retrying until its TCP port is open. Raises SimulatorUnreachable."""
    host, port = ports.host, ports.simulator_tcp
    wall_deadline_s = time.monotonic() + wall_timeout_s
    while True:
        try:
            connection = socket.create_connection((host, port), timeout=max(RETRY_S, wall_timeout_s))
        except OSError as error:
            if time.monotonic() >= wall_deadline_s:
                raise SimulatorUnreachable(
                    f"no simulator at {host}:{port} within {wall_timeout_s:g} s ({error.strerror or error})"
                ) from None
            time.sleep(RETRY_S)
        else:
            connection.settimeout(None)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return connection


class VehicleProcess:
    """A vehicle with its sockets; ``simulator`` is the inherited connection, if there is one."""

    def __init__(
        self, config: VehicleConfig, stack: contextlib.ExitStack, simulator: socket.socket | None = None
    ) -> None:
        ports = config.ports
        self._profile_from_us = config.profile_from_us
        self._radio: RadioClient | None = None
        if (endpoint := ports.radio_endpoint) is not None:
            self._radio = RadioClient(
                endpoint=endpoint.locator,
                password=endpoint.password,
                run_id=config.run_id,
                station=config.instance,
            )
            stack.enter_context(contextlib.closing(self._radio))
        self._host = stack.enter_context(contextlib.closing(Host(config, self._radio)))
        self._links = {
            number: stack.enter_context(contextlib.closing(link))
            for number, link in _open_links(config, self._host)
        }
        """The UDP links by their numbers."""
        self._link_messages = 0
        self._warned_links: set[int] = set()
        """Links of which a foreign sender was reported."""
        self._link_active: tuple[bool, ...] = ()
        """Whether each link has a listener, as of the last receive or send"""
        self._update_link_active()
        self._poll_us = 0
        self._wall_poll_s = self._wall_heartbeat_s = time.monotonic()
        if simulator is None:
            simulator = stack.enter_context(connect_simulator(ports, config.connect_timeout_s))
            simulator.sendall(self._host.introduction())
        self._simulator = simulator
        self._simulator_poll = select.poll()
        """Reports input from the simulator. A blocking `recv` would be woken twice in each step, also when
        the simulator reads the answer, which frees buffer space."""
        self._simulator_poll.register(self._simulator, select.POLLIN)
        self._link_poll = select.poll()
        """Reports input on the links: one system call, where reading takes one per link."""
        for link in self._links.values():
            self._link_poll.register(link, select.POLLIN)
        self._selector = stack.enter_context(contextlib.closing(selectors.DefaultSelector()))
        self._selector.register(self._simulator, selectors.EVENT_READ)
        for link in self._links.values():
            self._selector.register(link, selectors.EVENT_READ)

    def run(self) -> None:
        """Run until the simulator closes the connection."""
        emit(
            Ready(
                name=self._host.name,
                pid=os.getpid(),
                details={_PORT_NAMES[number]: link.local_port for number, link in self._links.items()},
            )
        )
        # Existing objects live to the end: exempt them from garbage collections in flight.
        gc.collect()
        gc.freeze()
        flight = self._host.vehicle.flight
        with (
            profiled(PROFILE_GROUPS, now_us=lambda: flight.now_us, from_us=self._profile_from_us) as profile,
            contextlib.suppress(ConnectionResetError, BrokenPipeError),  # also if the simulator died
        ):
            host, simulator = self._host, self._simulator
            while size := self._receive_simulator():
                answer = host.inertial_step(size)
                if answer is not None:
                    simulator.sendall(answer)
                    continue
                for messages in host.push(size):
                    simulator.sendall(self._step(messages))
        emit(
            Finished(
                name=self._host.name,
                details={
                    "ground_messages": self._link_messages + self._host.ground_messages,
                    "malformed_bytes": self._host.bad_bytes
                    + sum(link["bytes_bad"] for link in self._link_counts().values()),
                    "links": self._link_counts(),
                    "malformed_deliveries": 0 if self._radio is None else self._radio.malformed,
                    **self._host.vehicle.troubles(),
                    **profile,
                },
            )
        )

    def _link_counts(self) -> dict[str, dict[str, Any]]:
        """Counts of rejected and dropped messages of each link, by cause."""
        vehicle = self._host.vehicle
        counts = self._host.link_counts()
        for number, link in self._links.items():
            link.counters.not_addressed = vehicle.messaging.not_addressed[number]
            link.counters.rate_limited = vehicle.messaging.shapers.limited(number)
            counts[_LINK_NAMES[number]] = asdict(link.counters)
        return counts

    def _receive_simulator(self) -> int:
        """Read from the simulator and return the number of bytes, 0 at the end of the connection.

        The links are served while waiting.
        """
        while not self._simulator_poll.poll(_SILENCE_MS):
            self._wait()
        return self._simulator.recv_into(self._host.incoming)

    def _wait(self) -> None:
        """Serve the links, with answers as of the last step, until the simulator sends something."""
        while not any(key.fileobj is self._simulator for key, _ in self._selector.select(WALL_LINK_PERIOD_S)):
            incoming = self._receive()
            if incoming:
                self._send(self._host.serve_while_paused(incoming))
            self._wall_poll_s = time.monotonic()
            self._send_due_heartbeat()

    def _receive(self) -> Links:
        """Read messages from the links; the first one ends the run's determinism."""
        now_us = int(self._host.vehicle.flight.now_us)
        incoming = [
            Addressed(Partner(i, number), message)
            for i, link in self._links.items()
            for number, message in link.receive(now_us)
        ]
        self._update_link_active()
        self._warn_of_foreign(now_us)
        if incoming and not self._link_messages:
            emit(Influenced(name=self._host.name, by="a ground station or companion"))
        self._link_messages += len(incoming)
        return incoming

    def _warn_of_foreign(self, now_us: int) -> None:
        """Warn once of each link whose input was dropped because of its sender's user."""
        for i, link in self._links.items():
            if link.foreign is not None and i not in self._warned_links:
                self._warned_links.add(i)
                host, port = link.foreign
                text = (
                    f"MAVLink from {host}:{port} is dropped: its sender has ended or is of another user "
                    "(links.local_senders)"
                )
                emit(Warned(name=self._host.name, time_us=now_us, text=text))

    def _send(self, outgoing: Links) -> None:
        """Send messages on their links; the host has sent those of a ground link over the radio."""
        if any(to.link == GROUND_STATION and _is_heartbeat(message) for to, message in outgoing):
            self._wall_heartbeat_s = time.monotonic()
        for i, link in self._links.items():
            link.send([(to.number, message) for to, message in outgoing if to.link == i])
        self._update_link_active()

    def _update_link_active(self) -> None:
        self._link_active = tuple(
            number in self._links and self._links[number].active for number in _LINK_NAMES
        )

    def _send_due_heartbeat(self) -> None:
        """Send a heartbeat if simulated time has been too slow for one."""
        if self._host.vehicle.has_begun and time.monotonic() - self._wall_heartbeat_s >= HEARTBEAT_S:
            beat = self._host.vehicle.heartbeat()
            self._send([Addressed(Partner(link), beat) for link in self._links])

    def _step(self, simulator_messages: list[Message]) -> bytes:
        """Run one step for a HIL_SENSOR and the messages before it; return the answer to the simulator."""
        now_us: int = simulator_messages[-1].time_usec
        incoming: Links = []
        wall_s = time.monotonic()
        if now_us >= self._poll_us or wall_s - self._wall_poll_s >= WALL_LINK_PERIOD_S:
            self._poll_us = now_us - now_us % LINK_PERIOD_US + LINK_PERIOD_US
            if self._link_poll.poll(0):
                incoming = self._receive()
            self._wall_poll_s = wall_s
            self._send_due_heartbeat()
        answer, outgoing = self._host.step(
            simulator_messages, link_messages=incoming, link_active=self._link_active
        )
        if outgoing:
            # so that warnings are also visible without a ground station
            for text in warnings(outgoing):
                emit(Warned(name=self._host.name, time_us=now_us, text=text))
            self._send(outgoing)
        return answer


def _open_links(config: VehicleConfig, host: Host) -> Iterator[tuple[int, UdpLink]]:
    """Open the UDP links; yield them with their numbers. Raises OSError."""
    links, ports = config.links, config.ports
    owners = DatagramOwners(links.host) if links.local_senders == "own" else None
    remotes = {
        GROUND_STATION: (ports.gcs_local_udp, links.ground_station_host, ports.gcs_remote_udp),
        COMPANION: (ports.companion_local_udp, links.companion_host, ports.companion_remote_udp),
    }
    if config.ground_stations:
        del remotes[GROUND_STATION]  # it is over the radio
    for number, (local, remote_host, remote) in remotes.items():
        yield (
            number,
            UdpLink(
                host=links.host,
                local_port=local,
                remote_host=remote_host,
                remote_port=remote,
                encoder=host.link_settings.encoder(),
                signer=host.link_settings.signer(number),
                owners=owners,
                budget=InputBudget(),
                tap=host.open_ground_log() if number == GROUND_STATION else None,
            ),
        )


def _is_heartbeat(message: Message) -> bool:
    """Whether a message is the autopilot's heartbeat."""
    return bool(
        message.get_msgId() == common.MAVLINK_MSG_ID_HEARTBEAT
        and message.autopilot == common.MAV_AUTOPILOT_PX4
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse a command line, by default the process's, and run; a failure is a line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m autopilot", description="One UAV's autopilot and on-board application."
    )
    add = parser.add_argument
    add("--instance", type=int, default=0, help="vehicle number: system id minus one, PX4's port offset")
    add("--config", type=Path, help="JSON file with all settings; default: a single vehicle on PX4's ports")
    add("--connect-timeout-s", type=float, default=30.0, help="how long to retry to connect to the simulator")
    add("--params", type=Path, help="parameter file of a single vehicle, which is loaded and saved")
    add("--plan", type=Path, help="initial plan of a single vehicle (QGroundControl's .plan)")
    add("--simulator-fd", type=int, help="inherited stream socket to the simulator, used instead of its port")
    add("--supervised", action="store_true", help="exit when stdin is closed")
    given = parser.parse_args(arguments)
    try:
        if given.config is not None:
            config = msgspec.json.decode(given.config.read_bytes(), type=VehicleConfig)
        else:
            config = lone_vehicle(given.instance, given.connect_timeout_s, given.params, given.plan)
        if given.supervised:
            end_with_parent()
            yield_when_woken()
        with contextlib.ExitStack() as stack:
            stack.enter_context(watched(config.call_limit_s, on_stuck=partial(end_stuck, "uav")))
            simulator = None
            if given.simulator_fd is not None:
                simulator = stack.enter_context(socket.socket(fileno=given.simulator_fd))
            VehicleProcess(config, stack, simulator).run()
    except (
        OSError,
        msgspec.DecodeError,
        ParameterError,
        ParameterFileError,
        PlanFileError,
        PlanError,
        SigningKeyError,
        ExtensionError,
    ) as error:
        # also unreachable simulators and radios, which are OSErrors
        print(f"uav: {error}", file=sys.stderr)
        return 2
    except ExtensionFailure as error:
        traceback.print_exception(error)
        print(f"uav: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def lone_vehicle(
    instance: int, connect_timeout_s: float, params: Path | None = None, plan: Path | None = None
) -> VehicleConfig:
    """Return the configuration of a vehicle that was started by hand: PX4's ports, no radio, no application.

    Raises ParameterFileError for an invalid parameter file, PlanFileError for an invalid plan file.
    """
    values = parameter_file.load(params) if params is not None and params.exists() else {}
    plan_text = plan_file.load(plan) if plan is not None else None
    base = VehiclePorts()
    return msgspec.convert(
        {
            "run_id": "manual",
            "instance": instance,
            "seed": 0,
            "ports": {
                "simulator_tcp": base.simulator_tcp + instance,
                "gcs_local_udp": base.gcs_local_udp + instance,
                "companion_local_udp": base.companion_local_udp + instance,
                "companion_remote_udp": base.companion_remote_udp + instance,
            },
            "autopilot": msgspec.to_builtins(AutopilotConfig(params=values, plan=plan_text)),
            "params_path": None if params is None else str(params),
            "onboard": {"enabled": False},
            "places_ned_m": [[0.0, 0.0, 0.0]] * (instance + 1),
            "connect_timeout_s": connect_timeout_s,
        },
        VehicleConfig,
    )


if __name__ == "__main__":
    sys.exit(main())

"""``python -m autopilot --instance 3``: one UAV's process, and the only part of it that touches sockets.

It connects to the simulator as PX4 does (TCP, retrying until it is there) or by a Unix socket that it is told
of, to the run's radio, and opens its MAVLink links; then each HIL_SENSOR makes one step of the vehicle and
one answer. While the simulator is silent, for simulated time stands or is slow, the links are answered all
the same and heartbeats go on by wall clock. It ends when the simulator hangs up.
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
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from pymavlink.dialects.v20 import common

from foundation.kernels import cache_folder

if "--supervised" not in sys.argv:  # else the launcher has
    os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from autopilot.mavlink import signing
from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.links import UdpLink
from autopilot.mavlink.signing import SigningKeyError
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
from foundation.processes.child_protocol import Finished, Influenced, Ready, Warned, emit, end_with_parent
from foundation.profiling.profiler import profiled
from netsim.transport.lockstep_radio import RadioClient

RETRY_S = 0.1
LINK_PERIOD_US = 20_000
"""How often the links are looked at, at the next whole step: two system calls that mostly find nothing."""
WALL_LINK_PERIOD_S = 0.1
"""The same by wall clock, for simulated time may be slow."""
SILENCE_S = 0.5
"""Wall time after which a simulator that says nothing is taken to stand still."""
HEARTBEAT_S = 1.0
"""Wall time after which a heartbeat goes out whatever simulated time does: ground stations wait for three."""
_SILENCE_MS = round(SILENCE_S * 1e3)
_LINK_NAMES = {GROUND_STATION: "ground_station", COMPANION: "companion"}


class SimulatorUnreachable(ConnectionError):
    """No simulator where there should be one; the text is one line."""


def connect_simulator(ports: VehiclePorts, wall_timeout_s: float) -> socket.socket:
    """Connect to the simulator, trying again until its TCP port is there. Raises SimulatorUnreachable."""
    if ports.simulator_unix is not None:
        return _connect_unix(ports.simulator_unix)
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


def _connect_unix(name: str) -> socket.socket:
    """Connect to a Unix socket in the abstract namespace; whoever tells its name listens there already."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.connect(f"\0{name}")
    except OSError as error:
        connection.close()
        raise SimulatorUnreachable(f"no simulator at {name} ({error.strerror or error})") from None
    return connection


class VehicleProcess:
    """A vehicle and its edges."""

    def __init__(self, config: VehicleConfig, stack: contextlib.ExitStack) -> None:
        ports = config.ports
        self._profile_from_us = config.profile_from_us
        self._links = [stack.enter_context(contextlib.closing(link)) for link in _open_links(config)]
        self._radio: RadioClient | None = None
        if ports.radio_endpoint is not None:
            self._radio = RadioClient(
                endpoint=ports.radio_endpoint, run_id=config.run_id, station=config.instance
            )
            stack.enter_context(contextlib.closing(self._radio))
        self._host = stack.enter_context(contextlib.closing(Host(config, self._radio)))
        self._link_messages = 0
        self._link_active: tuple[bool, ...] = ()
        """Whether somebody listens, as of what was last received or sent"""
        self._look_who_listens()
        self._poll_us = 0
        self._wall_poll_s = self._wall_heartbeat_s = time.monotonic()
        self._simulator = stack.enter_context(connect_simulator(ports, config.connect_timeout_s))
        self._simulator.sendall(self._host.introduction())
        self._saying = select.poll()
        """Tells when the simulator has said something. Waiting in `recv` it would be woken once more in each
        step: when the simulator takes the answer, which makes room to send."""
        self._saying.register(self._simulator, select.POLLIN)
        self._calling = select.poll()
        """Tells whether something has come on a link: one system call, where reading takes one for each."""
        for link in self._links:
            self._calling.register(link, select.POLLIN)
        self._waiting = stack.enter_context(contextlib.closing(selectors.DefaultSelector()))
        self._waiting.register(self._simulator, selectors.EVENT_READ)
        for link in self._links:
            self._waiting.register(link, selectors.EVENT_READ)

    def run(self) -> None:
        """Fly until the simulator hangs up."""
        emit(
            Ready(
                name=self._host.name,
                pid=os.getpid(),
                details={
                    "gcs_local_udp": self._links[GROUND_STATION].local_port,
                    "companion_local_udp": self._links[COMPANION].local_port,
                },
            )
        )
        # What lives now lives to the end: no full collection need walk it in flight.
        gc.collect()
        gc.freeze()
        flight = self._host.vehicle.flight
        with (
            profiled(PROFILE_GROUPS, now_us=lambda: flight.now_us, from_us=self._profile_from_us) as profile,
            contextlib.suppress(ConnectionResetError, BrokenPipeError),  # a simulator that died hangs up too
        ):
            host, simulator = self._host, self._simulator
            while size := self._hear():
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
                    "ground_messages": self._link_messages,
                    "malformed_bytes": self._host.bad_bytes + sum(link.bad_bytes for link in self._links),
                    "links": self._link_counts(),
                    "malformed_deliveries": 0 if self._radio is None else self._radio.malformed,
                    **self._host.vehicle.troubles(),
                    **profile,
                },
            )
        )

    def _link_counts(self) -> dict[str, dict[str, int]]:
        """What each link did not take or send, by cause."""
        vehicle = self._host.vehicle
        for number, link in enumerate(self._links):
            link.counters.not_addressed = vehicle.messaging.not_addressed[number]
            link.counters.rate_limited = vehicle.messaging.shapers.limited(number)
        return {name: self._links[number].counters.told() for number, name in _LINK_NAMES.items()}

    def _hear(self) -> int:
        """Take what the simulator says next; returns how many bytes, 0 if it hung up.

        Meanwhile the links are attended to.
        """
        while not self._saying.poll(_SILENCE_MS):
            self._wait()
        return self._simulator.recv_into(self._host.incoming)

    def _wait(self) -> None:
        """Attend to the links until the simulator says something: time stands, so answers are of its last."""
        while not any(key.fileobj is self._simulator for key, _ in self._waiting.select(WALL_LINK_PERIOD_S)):
            incoming = self._receive()
            if incoming:
                self._send(self._host.serve_while_paused(incoming))
            self._wall_poll_s = time.monotonic()
            self._keep_beating()

    def _receive(self) -> Links:
        """What has come on the links, which ends the run's determinism."""
        incoming = [
            Addressed(Partner(i, number), message)
            for i, link in enumerate(self._links)
            for number, message in link.receive()
        ]
        self._look_who_listens()
        if incoming and not self._link_messages:
            emit(Influenced(name=self._host.name, by="a ground station or companion"))
        self._link_messages += len(incoming)
        return incoming

    def _send(self, outgoing: Links) -> None:
        """Put messages on their links."""
        if any(to.link == GROUND_STATION and _is_heartbeat(message) for to, message in outgoing):
            self._wall_heartbeat_s = time.monotonic()
        for i, link in enumerate(self._links):
            link.send([(to.number, message) for to, message in outgoing if to.link == i])
        self._look_who_listens()

    def _look_who_listens(self) -> None:
        self._link_active = tuple(link.active for link in self._links)

    def _keep_beating(self) -> None:
        """Send a heartbeat if simulated time has been too slow for one."""
        if self._host.vehicle.has_begun and time.monotonic() - self._wall_heartbeat_s >= HEARTBEAT_S:
            beat = self._host.vehicle.heartbeat()
            self._send([Addressed(Partner(link), beat) for link in range(len(self._links))])

    def _step(self, simulator_messages: list[Message]) -> bytes:
        """One step for a HIL_SENSOR and what came before it; returns what goes back to the simulator."""
        now_us: int = simulator_messages[-1].time_usec
        incoming: Links = []
        wall_s = time.monotonic()
        if now_us >= self._poll_us or wall_s - self._wall_poll_s >= WALL_LINK_PERIOD_S:
            self._poll_us = now_us - now_us % LINK_PERIOD_US + LINK_PERIOD_US
            if self._calling.poll(0):
                incoming = self._receive()
            self._wall_poll_s = wall_s
            self._keep_beating()
        answer, outgoing = self._host.step(
            simulator_messages, link_messages=incoming, link_active=self._link_active
        )
        if outgoing:
            # so that whoever looks on without a ground station sees what it is warned of
            for text in warnings(outgoing):
                emit(Warned(name=self._host.name, time_us=now_us, text=text))
            self._send(outgoing)
        return answer


def _open_links(config: VehicleConfig) -> Iterator[UdpLink]:
    """Open the links in the order of their numbers. Raises OSError and SigningKeyError."""
    links, ports = config.links, config.ports
    key, heard = None, signing.SigningStreams()
    if links.signing_key_file is not None:
        key = signing.key_of(Path(links.signing_key_file).read_bytes())
    remotes = (
        (ports.gcs_local_udp, links.ground_station_host, ports.gcs_remote_udp),
        (ports.companion_local_udp, links.companion_host, ports.companion_remote_udp),
    )
    for number, (local, remote_host, remote) in enumerate(remotes):
        yield UdpLink(
            host=links.host,
            local_port=local,
            remote_host=remote_host,
            remote_port=remote,
            encoder=Encoder(system=config.instance + 1, component=1),
            signer=None if key is None else signing.Signer(key, link_id=number, heard=heard),
        )


def _is_heartbeat(message: Message) -> bool:
    """Whether it is the autopilot's."""
    return bool(
        message.get_msgId() == common.MAVLINK_MSG_ID_HEARTBEAT
        and message.autopilot == common.MAV_AUTOPILOT_PX4
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse a command line, by default the process's, and fly; a failure is a line on stderr and status 2."""
    parser = argparse.ArgumentParser(
        prog="python -m autopilot", description="One UAV's autopilot and on-board application."
    )
    add = parser.add_argument
    add("--instance", type=int, default=0, help="vehicle number: system id less one, PX4's port offsets")
    add("--config", type=Path, help="JSON file with everything; without it a lone vehicle on PX4's ports")
    add("--connect-timeout-s", type=float, default=30.0, help="how long to look for the simulator")
    add("--params", type=Path, help="parameter file to start with, and to save to, of a lone vehicle")
    add("--plan", type=Path, help="QGroundControl's .plan to start with, of a lone vehicle")
    add("--supervised", action="store_true", help="end when stdin does")
    given = parser.parse_args(arguments)
    try:
        if given.config is not None:
            config = msgspec.json.decode(given.config.read_bytes(), type=VehicleConfig)
        else:
            config = lone_vehicle(given.instance, given.connect_timeout_s, given.params, given.plan)
        if given.supervised:
            end_with_parent()
            _yield_to_the_simulator()
        with contextlib.ExitStack() as stack:
            VehicleProcess(config, stack).run()
    except (
        OSError,
        msgspec.DecodeError,
        ParameterError,
        ParameterFileError,
        PlanFileError,
        PlanError,
        SigningKeyError,
    ) as error:
        # unreachable simulators and radios are among the first
        print(f"uav: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _yield_to_the_simulator() -> None:
    """Do not preempt the processes that serve everybody when this one wakes up.

    Otherwise the first vehicle that gets its sensors takes the processor from the physics server, which has
    yet to send the others theirs.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # a sandbox that forbids it costs time, and no flight
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def lone_vehicle(
    instance: int, connect_timeout_s: float, params: Path | None = None, plan: Path | None = None
) -> VehicleConfig:
    """A vehicle that was started by hand: PX4's ports, no radio, and nobody aboard but the ground station.

    Raises ParameterFileError for a parameter file that is there and wrong, PlanFileError for a plan file.
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

"""The processes of one run: which there are, in what order they start and end, and what they have said.

Composes `harness.launch.supervisor` with the commands that coflight's own processes take. What simulated time
is spent on is decided in `harness.launch.swarm`.
"""

import contextlib
import socket
import sys
import time
import uuid
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any

import msgspec
import psutil
from msgspec import Struct

from foundation.processes.child_protocol import Finished, Influenced, Ready, Warned
from harness.launch import cpu_affinity, kernel_cache, px4
from harness.launch.cpu_affinity import CpuAffinity
from harness.launch.interrupts import interrupts_deferred
from harness.launch.px4 import Px4Error
from harness.launch.resources import HAS_NAMED_SOCKETS, ResourceError, allow_descriptors, bind, bind_local
from harness.launch.supervisor import ChildMessage, Exited, Supervisor, SupervisorError
from harness.records.run_folder import RunFolder
from harness.scenario.scenario import Scenario
from harness.simulator.messages import AnyCommand, AnyEvent, Formed, Paused, Progress, SetPid, VehicleLost

PHYSICS, RADIO, PREFORK = "physics", "radio", "prefork"
START_LIMIT_S = 120.0
"""Wall time within which every process must be ready to work."""
STOP_LIMIT_S = 10.0
"""Wall time that processes have to write what they have and end."""
_ENVIRONMENT = {
    # each process is one thread of the swarm's work: a BLAS with threads of its own would fight the others
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONFAULTHANDLER": "1",
}


class ProcessNotice(Struct, frozen=True, kw_only=True):
    """The launcher itself has something to say, before it takes long."""

    text: str


Message = ChildMessage | Exited | ProcessNotice
Happening = AnyEvent | Warned | Exited


class SwarmError(Exception):
    """The swarm cannot fly, or not go on; the text is one line for the user."""


class SetupError(SwarmError):
    """It could not be started as asked: a port or a folder cannot be had."""


class SwarmTimeoutError(SwarmError):
    """What was waited for did not happen in time."""


def uav(instance: int) -> str:
    """Name of a vehicle's process."""
    return f"uav {instance}"


def application(instance: int) -> str:
    """Name of the process of an on-board application beside a PX4."""
    return f"application {instance}"


def python_module(module: str, *arguments: str) -> list[str]:
    """Command that runs one of coflight's processes."""
    # -P: nothing in the working folder may stand in for a module
    return [sys.executable, "-P", "-m", module, *arguments]


def supervised(config: Path) -> tuple[str, ...]:
    """Arguments of one of coflight's processes that is a child of this one."""
    return ("--config", str(config), "--supervised")


class Processes:
    """Physics server, 802.11 emulator and one process per vehicle, forked by the prefork server.

    ``wall_limit_s`` bounds the run's wall time from `start` on; ``on_message`` is given all that is taken
    from the processes, on the taker's thread. ``supervisor`` is whose children they are, if not children of
    this process.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: RunFolder,
        *,
        wall_limit_s: float | None,
        on_message: Callable[[Message], None] | None,
        supervisor: Supervisor | None = None,
    ) -> None:
        self._scenario = scenario
        self._folder = folder
        self._wall_limit_s = wall_limit_s
        self._wall_start_s = time.monotonic()
        self._on_message = on_message
        if supervisor is None:
            environment = _ENVIRONMENT | kernel_cache.environment()
            supervisor = Supervisor(folder.logs, environment=environment)
        self._supervisor = supervisor
        self._ports: set[int] = set()
        self._px4 = px4.instances(scenario)
        self._has_hangar = len(self._px4) < scenario.agents
        self._running = False
        self._placement: CpuAffinity | None = None
        self._met = False
        """Whether every vehicle has connected to the physics server."""
        self.ready: dict[str, Ready] = {}
        self.finished: dict[str, dict[str, Any]] = {}
        """What each process said in its last event."""
        self.influences: list[Influenced] = []
        """What came from outside and so made the run depend on more than scenario and seed."""
        self.exited: dict[str, Exited] = {}
        self.happenings: list[Happening] = []
        """What the processes said and how they ended, less progress and answers."""
        self.simulated_us = 0
        self.wall_paused_s = 0.0
        """Wall time for which the run that lasts, or was the last, has stood on request."""
        self.formed_us: int | None = None
        self.failure: str | None = None
        """Why no command can be carried out any more, or that what was written down is not whole."""
        self.forced: tuple[str, ...] = ()
        """After the stop: a line for each process that had to be made to end."""
        self.records_lost: str | None = None
        """After the stop: why what physics or the radio wrote down is not whole, if it is not."""

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return self._supervisor.pids

    def nondeterminism(self, killed: Container[int] = ()) -> list[str]:
        """What made this run depend on more than scenario and seed, a line each; ``killed`` were by plan."""
        losses = {event.instance: event.reason for event in self.happenings if isinstance(event, VehicleLost)}
        lost = [
            f"{uav(instance)} was lost for no simulated reason: {reason}"
            for instance, reason in losses.items()
            if instance not in killed
        ]
        endings = (
            self._cut_short(uav(i))
            for i in range(self._scenario.agents)
            if i not in killed and i not in losses
        )
        spoken_to = [f"{event.name} was spoken to by {event.by}" for event in self.influences]
        return [
            *lost,
            *filter(None, [self.records_lost, *endings]),
            *spoken_to,
            *(f"{uav(i)} is flown by a PX4, and its application keeps its time" for i in self._px4),
        ]

    @property
    def running(self) -> bool:
        """Started, and not stopped."""
        return self._running

    def start(self) -> None:
        """Start every process and wait until all are ready. The caller stops them if this fails.

        Raises SetupError for a port, a folder or file descriptors that cannot be had, and SwarmError for a
        process that fails.
        """
        self._wall_start_s = time.monotonic()
        try:
            self._running = True
            self._start()
        except (ResourceError, Px4Error) as error:
            raise SetupError(str(error)) from None
        except OSError as error:
            raise SetupError(
                f"{error.filename}: {error.strerror}" if error.filename else str(error)
            ) from None
        except (SupervisorError, kernel_cache.CompileError) as error:
            raise SwarmError(str(error)) from None

    def _note(self, text: str) -> None:
        if self._on_message is not None:
            self._on_message(ProcessNotice(text=text))

    def _start(self) -> None:
        scenario, host, run_id = self._scenario, self._scenario.ports.host, uuid.uuid4().hex[:16]
        vehicles = range(scenario.agents)
        allow_descriptors(len((PHYSICS, RADIO, PREFORK)) + len(vehicles) + len(self._px4))
        self._check_ports()
        kernel_cache.prepare(self._note)
        with contextlib.ExitStack() as sockets:
            base = scenario.ports.simulator_tcp
            listeners = [
                sockets.enter_context(bind(socket.SOCK_STREAM, host, base + i if base else 0))
                for i in vehicles
            ]
            simulator_ports = [listener.getsockname()[1] for listener in listeners]
            self._ports.update(simulator_ports)
            own_name = self._own_link_name(run_id)
            RunFolder.create(self._folder.path)
            if self._has_hangar:  # it takes longest, and needs none of the others
                self._supervisor.start_forker(
                    PREFORK, python_module("autopilot.process.prefork_server", "--supervised")
                )
            clock = [sockets.enter_context(end) for end in socket.socketpair()]
            radio_fd, physics_fd = (end.fileno() for end in clock)
            config = self._folder.write_radio_config(scenario, run_id=run_id)
            command = python_module("netsim", *supervised(config), "--clock-fd", str(radio_fd))
            self._supervisor.start(RADIO, command, pass_fds=[radio_fd])
            fds = [listener.fileno() for listener in listeners]
            config = self._folder.write_physics_config(scenario, run_id=run_id)
            command = python_module("harness.simulator.server", *supervised(config))
            command += ["--listen-fds", ",".join(map(str, fds)), "--clock-fd", str(physics_fd)]
            if own_name is not None:
                own_listener = sockets.enter_context(bind_local(own_name, backlog=len(vehicles)))
                fds.append(own_listener.fileno())
                command += ["--own-listen-fd", str(own_listener.fileno())]
            if self._px4:  # whose applications' words reach it by way of the radio
                command += ["--radio-endpoint", self._radio_endpoint()]
            self._supervisor.start(PHYSICS, command, pass_fds=[*fds, physics_fd])
        endpoint = self._radio_endpoint()
        if self._has_hangar:
            self._await_ready([PREFORK])
        for i in vehicles:
            config = self._folder.write_vehicle_config(
                scenario,
                i,
                run_id=run_id,
                simulator_port=simulator_ports[i],
                radio_endpoint=endpoint,
                simulator_unix=None if i in self._px4 else own_name,
            )
            if i in self._px4:
                self._start_px4(i, simulator_ports[i])
                self._supervisor.start(
                    application(i), python_module("autopilot.process.companion", *supervised(config))
                )
            else:
                self._supervisor.fork(uav(i), supervised(config), forker=PREFORK)
        self._await_ready([PHYSICS, *map(uav, vehicles), *map(application, self._px4)])
        for i in vehicles:
            details = self.ready[uav(i)].details
            self._ports |= {details["gcs_local_udp"], details["companion_local_udp"]}
            self.send(SetPid(instance=i, pid=self.ready[uav(i)].pid))
        self._place()

    def _place(self) -> None:
        """Have the processes keep to processors of their own while nobody else needs those."""
        vehicles = list(map(uav, range(self._scenario.agents)))
        processors = cpu_affinity.own_processors()
        places = cpu_affinity.homes(vehicles, processors, first=RADIO, last=PHYSICS)
        if places is not None and places.keys() <= self.pids.keys() and not self._px4:
            self._placement = CpuAffinity(self._living, places, processors)

    def _living(self) -> dict[str, int]:
        return {name: pid for name, pid in self.pids.items() if self._supervisor.alive(name)}

    def _own_link_name(self, run_id: str) -> str | None:
        """Name of the Unix socket at which own vehicles meet the simulator; None: at its TCP ports."""
        wanted = self._scenario.ports.simulator_link == "unix" and self._has_hangar
        return f"coflight-{run_id}" if wanted and HAS_NAMED_SOCKETS else None

    def _start_px4(self, instance: int, simulator_port: int) -> None:
        seat = px4.seat(self._scenario, instance, run_folder=self._folder.path, simulator_port=simulator_port)
        config = self._folder.config / f"px4-{instance}.json"
        config.write_bytes(msgspec.json.format(msgspec.json.encode(seat), indent=2))
        self._supervisor.start(
            uav(instance), python_module("harness.launch.external_process", *supervised(config))
        )

    def _radio_endpoint(self) -> str:
        """Where the stations connect, once the emulator listens."""
        self._await_ready([RADIO])
        endpoint: str = self.ready[RADIO].details["endpoint"]
        self._ports.add(int(endpoint.rpartition(":")[2]))
        return endpoint

    def _check_ports(self) -> None:
        """Find a port in use before anything starts; a process that loses one afterwards says so itself."""
        ports = self._scenario.ports
        px4.check_start(self._scenario)
        for port in px4.application_ports(self._scenario):
            bind(socket.SOCK_DGRAM, ports.host, port).close()
        for base in (ports.gcs_local_udp, ports.companion_local_udp):
            for i in range(self._scenario.agents if base else 0):
                bind(socket.SOCK_DGRAM, self._scenario.links.host, base + i).close()
        if ports.radio_tcp:
            bind(socket.SOCK_STREAM, ports.host, ports.radio_tcp).close()

    def _await_ready(self, names: Sequence[str]) -> None:
        deadline_s = time.monotonic() + START_LIMIT_S
        while missing := [name for name in names if name not in self.ready]:
            late = f"not ready within {START_LIMIT_S:g} s: {', '.join(missing)}"
            message = self.next(deadline_s - time.monotonic(), late)
            if isinstance(message, Exited):
                raise SwarmError(self._obituary(message))

    def stop(self) -> None:
        """End every process; harmless when repeated.

        Ctrl-C in the meantime takes effect afterwards. If nobody obeys, it takes about a minute of wall time.
        """
        if not self._running:
            return
        with interrupts_deferred():
            self._running = False
            if self._placement is not None:
                self._placement.end()
            forced: list[str] = []
            # a vehicle ends when its simulator hangs up, and the radio outlives those who use it
            vehicles = [*map(uav, range(self._scenario.agents)), *map(application, self._px4)]
            for names in ([PHYSICS], vehicles, [RADIO, PREFORK]):
                forced += self._supervisor.end(names, grace_s=STOP_LIMIT_S)
            self.forced = (*forced, *self._supervisor.stop())
            self.drain()
            self.records_lost = next(filter(None, map(self._cut_short, (PHYSICS, RADIO))), None)
            if self.records_lost is not None:
                self.note_failure(self.records_lost)

    def _cut_short(self, name: str) -> str | None:
        """Line for a process that has worked and did not come to write all it had; None: it did."""
        if name not in self.ready:
            return None
        exited = self.exited.get(name)
        if exited is None:
            return f"{name} does not end"
        if exited.returncode != 0:
            return self._obituary(exited)
        return None if name in self.finished else f"{exited.describe()}, but did not finish"

    def kill(self, instance: int) -> None:
        """SIGKILL a vehicle's process, or processes; returns when they are gone."""
        for name in (uav(instance), application(instance)) if instance in self._px4 else (uav(instance),):
            self._supervisor.kill(name)
        self.drain()

    def send(self, command: AnyCommand) -> None:
        """Give the physics server a command. Raises SwarmError if it cannot take one."""
        if not self._running or PHYSICS not in self.ready:  # too early is no reason to give the run up
            raise SwarmError("the swarm is not running")
        try:
            self._supervisor.send(PHYSICS, command)
        except SupervisorError as error:
            raise self.fatal(SwarmError(str(error))) from None

    def next(self, wall_limit_s: float, complaint: str) -> Message:
        """Next message of any process, which must come in time.

        Raises SwarmTimeoutError with the complaint, or SwarmError if a process that every run needs ended.
        """
        if self._wall_limit_s is not None:
            left_s = self._wall_start_s + self._wall_limit_s - time.monotonic()
            if left_s < wall_limit_s:
                wall_limit_s, complaint = left_s, f"the wall time of {self._wall_limit_s:g} s is over"
        message = self._take(wall_limit_s)
        if message is None:
            raise self.fatal(SwarmTimeoutError(complaint))
        if self.failure is not None:
            raise SwarmError(self.failure)
        return message

    def deaths(self) -> list[str]:
        """How processes came to a bad end, one line each, in order."""
        self.drain()
        return [self._obituary(exited) for exited in self.exited.values() if exited.returncode]

    def drain(self) -> None:
        """File what has come in."""
        while self._take(0.0) is not None:
            pass

    def note_failure(self, reason: str) -> None:
        """Remember why the run failed, unless that is known already."""
        if self.failure is None:
            self.failure = reason

    def fatal(self, error: SwarmError) -> SwarmError:
        """Remember why the run cannot go on; returns the error, to be raised."""
        self.failure = str(error)
        return error

    def _take(self, wall_limit_s: float) -> Message | None:
        heard = self._supervisor.hear(wall_limit_s)
        if heard is None:
            return None
        name, message = heard
        match message:
            case Ready():
                self.ready[name] = message
            case Finished():
                self.finished[name] = message.details
            case Influenced():
                self.influences.append(message)
            case Progress() | Paused():
                self._met = True
                self.simulated_us = message.time_us
                self.wall_paused_s = message.wall_paused_s
            case _:
                self.happenings.append(message)
        if isinstance(message, Formed):
            self.formed_us = message.time_us
        elif isinstance(message, Exited):
            self.exited[name] = message
            if self._is_needed(name) and self._running and self.failure is None:
                self.failure = self._obituary(message)
        if self._on_message is not None:
            self._on_message(message)
        return message

    def _is_needed(self, name: str) -> bool:
        """Whether no run goes on without that process: without a PX4 none begins."""
        return name in (PHYSICS, RADIO, PREFORK) or (not self._met and name in map(uav, self._px4))

    def _obituary(self, exited: Exited) -> str:
        if not exited.last_words:
            return exited.describe()
        return f"{exited.describe()}: {exited.last_words} (log: {self._supervisor.log_path(exited.name)})"

    def log_tails(self, lines: int) -> dict[str, str]:
        """Last lines of each process's log, by name."""
        return {name: self._supervisor.log_tail(name, lines) for name in self.pids}

    def leftovers(self) -> list[str]:
        """After the stop: a line for each process that still lives, and for each port that is still held."""
        left = [
            f"{process.name()} (pid {process.pid}) of {name}" for process, name in self._supervisor.strays()
        ]
        # when they are gone, only this process can still hold a port of theirs
        held = {c.laddr.port for c in psutil.Process().net_connections("inet") if c.laddr}
        return left + [f"port {port}" for port in sorted(held & self._ports)]

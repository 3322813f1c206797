"""The processes of one run: their commands, the order of start and end, and their messages.

Composes `harness.launch.supervisor` with the command lines of coflight's own processes. Simulated time is
controlled by `harness.launch.swarm`.
"""

import contextlib
import shutil
import socket
import time
import uuid
from collections.abc import Callable, Container, Mapping, Sequence

import psutil

from autopilot.logs.vehicle_record import vehicle_record
from autopilot.process.iteration import APPLICATION
from foundation.processes.prefork import FIRST_DESCRIPTOR
from foundation.records.record_log import cut_to_blocks
from foundation.system_error import in_words
from harness.launch import cpu_affinity, external_autopilots, ground_process, kernel_cache, ports
from harness.launch.cpu_affinity import CpuAffinity
from harness.launch.disk_space import space_warning
from harness.launch.external_process import AutopilotError
from harness.launch.interrupts import interrupts_deferred
from harness.launch.process_commands import (
    NETWORK,
    PHYSICS,
    PREFORK,
    RADIO,
    application,
    bound_module,
    ground_station,
    supervised,
    uav,
)
from harness.launch.radio_link import RadioLink
from harness.launch.resources import ResourceError, allow_descriptors
from harness.launch.run_messages import (
    Compiling,
    Message,
    ProcessNotice,
    SetupError,
    SwarmError,
)
from harness.launch.run_monitor import RunMonitor
from harness.launch.socket_pairs import SocketPairs, descriptor_list
from harness.launch.supervisor import Exited, Supervisor, SupervisorError
from harness.launch.vehicle_network import ProgramStarts, network_config, write_holders
from harness.records.run_folder import FolderRefused, RunFolder
from harness.scenario.scenario import Scenario
from harness.simulator.messages import (
    AnyCommand,
    ApplicationLost,
    SetPid,
    SetRadioPid,
    VehicleLost,
)
from netsim.network.messages import StartPrograms
from netsim.network.namespaces import why_not

START_LIMIT_S = 120.0
"""Wall time within which every process must be ready."""
STOP_LIMIT_S = 5.0
"""Wall time for which a process may sleep that is to write its data and end; a PX4's wrapper needs 4 s."""
ENDS_LIMIT_S = 2.0
"""Wall time that vehicles have to end after their simulator, before their prefork server is killed."""
_LINK_PORTS = ("gcs_local_udp", "companion_local_udp")
_ENVIRONMENT = {
    # each process does its work in one thread: threads of a BLAS would compete with the other processes
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONFAULTHANDLER": "1",
}


class Processes(RunMonitor):
    """Physics server, 802.11 emulator, and a process for each vehicle, application and ground station.

    Applications have one beside a PX4 or ArduPilot, ground stations on the radio. Vehicles, except PX4s, and
    applications are forked by the prefork server.

    ``wall_limit_s`` limits the run's wall time from `start` on, without the compilation of kernels;
    ``on_message`` receives every message that is taken from the queue, on the caller's thread.
    ``search_ports``: raise all ports if some are in use.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: RunFolder,
        *,
        wall_limit_s: float | None,
        on_message: Callable[[Message], None] | None,
        search_ports: bool = False,
    ) -> None:
        self._scenario = scenario
        self._search_ports = search_ports
        self._ports: set[int] = set()
        self._external = external_autopilots.instances(scenario)
        """Vehicles whose autopilot is another program."""
        self._has_claim = False
        """Whether the ports and instance numbers are this swarm's."""
        self._applications = self._external if scenario.onboard.enabled else ()
        """Vehicles whose application is a process of its own."""
        self._grounds = [ground_station(each.name) for each in scenario.ground_stations]
        """Processes of the ground stations on the radio."""
        super().__init__(
            self._make_supervisor(folder),
            folder,
            starting=[
                *map(uav, range(scenario.agents)),
                *map(application, self._applications),
                *self._grounds,
            ],
            until_connected=[*map(uav, self._external)],
            expendable=dict.fromkeys(self._grounds, "the flight goes on without its programs"),
            call_limit_s=scenario.run.silence_limit_s,
            wall_limit_s=wall_limit_s,
            on_message=on_message,
        )
        self._has_own = len(self._external) < scenario.agents
        """Whether coflight's autopilot flies any vehicle."""
        self._has_prefork = self._has_own or bool(self._applications)
        self._radio: RadioLink | None = None
        self._program_starts = ProgramStarts(scenario)
        self._kernels = kernel_cache.Compilers()
        self._affinity: CpuAffinity | None = None
        self.forced: tuple[str, ...] = ()
        """After the stop: a line for each process that had to be forced to end."""
        self.records_lost: str | None = None
        """After the stop: why the records of physics or radio are incomplete; None: they are complete."""

    def _make_supervisor(self, folder: RunFolder) -> Supervisor:
        return Supervisor(folder.logs, environment=_ENVIRONMENT | kernel_cache.environment())

    @property
    def scenario(self) -> Scenario:
        """The scenario, after the start with the ports that are used."""
        return self._scenario

    def nondeterminism(self, killed: Container[int] = ()) -> list[str]:
        """Return a line per cause that made this run depend on more than scenario and seed.

        ``killed`` are the vehicles that were killed deliberately.
        """
        losses = {event.instance: event.reason for event in self.events if isinstance(event, VehicleLost)}
        applications_lost = [event for event in self.events if isinstance(event, ApplicationLost)]
        others = [i for i in range(self._scenario.agents) if i not in killed and i not in losses]
        return [
            *(
                f"{uav(instance)} was lost for no simulated reason: {reason}"
                for instance, reason in losses.items()
                if instance not in killed
            ),
            *(
                f"{application(event.instance)} was lost for no simulated reason: {event.reason}"
                for event in applications_lost
                if event.instance not in killed
            ),
            *filter(None, [self.records_lost, *(self._incomplete(uav(i)) for i in others)]),
            *filter(None, map(self._incomplete, self._grounds)),
            *(f"{event.name} received messages from {event.by}" for event in self.influences),
            *(
                f"{uav(i)} is flown by {external_autopilots.TITLES[self._scenario.autopilot.kind_of(i)]}, "
                "whose threads depend on the machine"
                for i in self._external
            ),
        ]

    def start(self) -> None:
        """Create the folder, start every process and wait until all are ready.

        If this fails, the caller stops them, and discards the folder if no process has failed.

        Raises SetupError for a port, a folder or file descriptors that are not available, and SwarmError for
        a process that fails.
        """
        try:
            if self._scenario.has_network and (reason := why_not()) is not None:
                raise SetupError(reason)
            self._running = True
            self._folder.create()  # first: an error after the kernels are compiled would be late
            free_bytes = shutil.disk_usage(self._folder.path).free
            line = space_warning(self._scenario, str(self._folder.path), free_bytes)
            if line is not None:
                self._note(line)
            self._start()
        except (ResourceError, FolderRefused, AutopilotError) as error:
            raise SetupError(str(error)) from None
        except OSError as error:
            raise SetupError(in_words(error)) from None
        except (SupervisorError, kernel_cache.CompileError) as error:
            raise SwarmError(str(error)) from None

    def _note(self, text: str) -> None:
        self._on_message(ProcessNotice(text=text))

    def _on_compiled(self, packages: Mapping[str, kernel_cache.CompileProgress]) -> None:
        self._on_message(Compiling(packages=dict(packages)))

    def prepare_report(self) -> None:
        """Compile the kernels that the flight did not need.

        If they do not compile together, the report compiles each that it needs.
        """
        try:
            kernel_cache.prepare(self._note, self._on_compiled)
        except kernel_cache.CompileError as error:
            self._note(str(error))

    def _start(self) -> None:
        vehicles = range(self._scenario.agents)
        single = len((PHYSICS, RADIO, PREFORK)) + len(self._grounds)
        allow_descriptors(single + len(vehicles) + 3 * len(self._applications))
        own = set(vehicles) - set(ports.tcp_vehicles(self._scenario))
        # both ends of each link to the simulator, until the two processes have them
        with (
            SocketPairs(sorted(own)) as own_links,
            SocketPairs(self._applications) as application_links,
            contextlib.closing(self._claim_ports()) as claim,
        ):
            self._start_linked(claim, own_links, application_links)
        for i in vehicles:
            details = self.ready[uav(i)].details
            self._ports |= {details[name] for name in _LINK_PORTS if name in details}
            self.send(SetPid(instance=i, pid=self.ready[uav(i)].pid))
        for i in self._applications:
            self.send(SetPid(instance=i, pid=self.ready[application(i)].pid, is_application=True))
        for name in self._grounds:
            self._ports.update(self.ready[name].details["gcs_local_udp"])
        self.send(SetRadioPid(pid=self.ready[RADIO].pid))
        self._pin()
        if NETWORK in self.ready:
            write_holders(self._folder.network, self.ready[NETWORK].details["holders"])
            self._start_programs(self._program_starts.before_flight())

    def _start_programs(self, numbers: tuple[int, ...]) -> None:
        if numbers and self._supervisor.alive(NETWORK):
            self._supervisor.send(NETWORK, StartPrograms(programs=numbers))

    def _take(self, wall_limit_s: float) -> Message | None:
        message = super()._take(wall_limit_s)
        if message is not None and self._running:
            self._start_programs(self._program_starts.due(message))
        return message

    def _start_linked(
        self, claim: ports.Claim, own_links: SocketPairs, application_links: SocketPairs
    ) -> None:
        """Start all processes; physics is linked to own vehicles and applications by socket pairs."""
        run_id, scenario, vehicles = uuid.uuid4().hex[:16], claim.scenario, range(self._scenario.agents)
        with contextlib.ExitStack() as sockets:
            with interrupts_deferred():  # the stop removes the folder that this makes
                self._radio = radio = RadioLink(scenario, self._folder, run_id=run_id)
            if self._folder.has_live_records:  # a view computes patterns in flight
                kernel_cache.prepare(self._note, self._on_compiled)
            self._kernels = kernel_cache.prepare_flight(self._note, self._on_compiled)
            self._wall_start_s = time.monotonic()
            simulator_ports = {i: each.getsockname()[1] for i, each in claim.listeners.items()}
            self._ports.update(simulator_ports.values())
            if self._has_prefork:  # starts first: it takes longest and needs no other process
                self._supervisor.start_forker(
                    PREFORK, bound_module("autopilot.process.prefork_server", "--supervised")
                )
            radio_end, physics_end = map(sockets.enter_context, socket.socketpair())
            config = self._folder.write_radio_config(scenario, radio.config)
            command = bound_module("netsim", *supervised(config), "--interval-fd", str(radio_end.fileno()))
            self._supervisor.start(RADIO, command, pass_fds=[radio_end.fileno()])
            config = self._folder.write_physics_config(scenario, run_id=run_id)
            command = bound_module("harness.simulator.server", *supervised(config))
            command += ["--interval-fd", str(physics_end.fileno())]
            fds = [physics_end.fileno()]
            for option, descriptors in (
                ("--listen-fds", {i: each.fileno() for i, each in claim.listeners.items()}),
                ("--vehicle-fds", own_links.server_descriptors()),
                ("--application-fds", application_links.server_descriptors()),
                ("--state-fds", {i: each.fileno() for i, each in claim.states.items()}),
            ):
                command += [option, descriptor_list(descriptors)] if descriptors else []
                fds += descriptors.values()
            self._supervisor.start(PHYSICS, command, pass_fds=fds)
        claim.close_server_sockets()
        for links in (own_links, application_links):
            links.close_server_ends()
        self._await_ready([RADIO])
        endpoint = self.ready[RADIO].details["endpoint"]
        self._ports |= radio.open(endpoint)
        companion_ports: dict[str, int] = {}
        if radio.packets_endpoint is not None:
            settings = network_config(scenario, radio.packets_endpoint, run_id=run_id, logs=self._folder.logs)
            path = self._folder.write_config(NETWORK, settings)
            self._supervisor.start(NETWORK, bound_module("netsim.network", *supervised(path)))
            self._await_ready([NETWORK])
            companion_ports = self.ready[NETWORK].details["companion_ports"]
        for number, each in enumerate(scenario.ground_stations):
            login = radio.station_login(each.name)
            ground = ground_process.settings(scenario, number, login, endpoint=endpoint, run_id=run_id)
            path = self._folder.write_config(f"ground-station-{each.name}", ground)
            self._supervisor.start(ground.name, bound_module("harness.ground_station", *supervised(path)))
        if self._has_prefork:
            self._await_ready([PREFORK])
        for i in vehicles:
            config = self._folder.write_vehicle_config(
                scenario,
                i,
                run_id=run_id,
                simulator_port=simulator_ports.get(i, 0),
                radio_endpoint=radio.endpoint,
                companion_port=companion_ports.get(str(i)),
            )
            if i in self._external:
                self._start_external(i, simulator_ports[i])
            elif i in simulator_ports:
                self._supervisor.fork(uav(i), supervised(config), forker=PREFORK)
            else:
                self._fork_linked(uav(i), supervised(config), own_links, i)
            if i in self._applications:
                self._fork_linked(application(i), (APPLICATION, *supervised(config)), application_links, i)
        applications = map(application, self._applications)
        self._await_ready([PHYSICS, *map(uav, vehicles), *applications, *self._grounds])

    def _pin(self) -> None:
        """Pin the processes to processors while other processes are idle, applications to their vehicle's."""
        vehicles = range(self._scenario.agents)
        processors = cpu_affinity.usable_processors()
        assignment = cpu_affinity.assign_processors(
            list(map(uav, vehicles)), processors, first=RADIO, last=PHYSICS
        )
        if assignment is not None and assignment.keys() <= self.pids.keys():
            assignment |= {application(i): assignment[uav(i)] for i in self._applications}
            threaded = list(map(uav, self._external))
            self._affinity = CpuAffinity(self._living, assignment, processors, threaded=threaded)

    def _living(self) -> dict[str, int]:
        """Return the process ids by name; of a PX4 it is the program's, not its wrapper's."""
        return {name: ready.pid for name, ready in self.ready.items() if self._supervisor.alive(name)}

    def _fork_linked(self, name: str, arguments: Sequence[str], links: SocketPairs, instance: int) -> None:
        """Fork a process with its end of a link to the simulator."""
        with links.handed_over(instance) as descriptor:
            self._supervisor.fork(
                name,
                (*arguments, "--simulator-fd", str(FIRST_DESCRIPTOR)),
                forker=PREFORK,
                pass_fds=[descriptor],
            )

    def _start_external(self, instance: int, simulator_port: int) -> None:
        config = external_autopilots.process_config(
            self._scenario, instance, run_folder=self._folder.path, simulator_port=simulator_port
        )
        path = self._folder.write_config(f"{self._scenario.autopilot.kind}-{instance}", config)
        self._supervisor.start(
            uav(instance), bound_module("harness.launch.external_process", *supervised(path))
        )

    def _claim_ports(self) -> ports.Claim:
        """Return free ports with the simulator's sockets, and take them over into the scenario."""
        external_autopilots.check_start(self._scenario)
        before = self._scenario.ports
        claim = ports.claim(self._scenario, search=self._search_ports)
        self._scenario, self._has_claim = claim.scenario, True
        used = self._scenario.ports
        if used != before:
            offset = max(used.numbers().values()) - max(before.numbers().values())
            station = used.gcs_remote_udp if self._has_own else 0
            line = f"ports or instances are in use by another program, so this swarm's are raised by {offset}"
            self._note(f"{line}: a ground station receives on UDP {station}" if station else line)
        return claim

    def _await_ready(self, names: Sequence[str]) -> None:
        deadline_s = time.monotonic() + START_LIMIT_S
        while missing := [name for name in names if name not in self.ready]:
            late = f"not ready within {START_LIMIT_S:g} s: {', '.join(missing)}"
            message = self.next(deadline_s - time.monotonic(), late)
            if isinstance(message, Exited):
                raise SwarmError(self.cause_of(message.name, message))

    def stop(self, *, at_once: bool = False) -> None:
        """End every process; harmless when repeated.

        Ctrl-C takes effect afterwards. Takes some seconds of wall time if a process does not react, longer
        if processes compute or get no processor time. A process that is known to be stopped or to hang is
        killed at once. With ``at_once``, before the flight, processes have no data to write and get no time
        for it.
        """
        if not self._running:
            return
        with interrupts_deferred():
            self._running = False
            if self._affinity is not None:
                self._affinity.end()
            self._kernels.close()
            forced: list[str] = []
            self._kill_found()
            # a vehicle ends when its simulator disconnects; the radio ends after its users
            vehicles = [*map(uav, range(self._scenario.agents)), *map(application, self._applications)]
            if at_once:
                self.drain()
                self._supervisor.stop(input_grace_s=0.0)  # one that still starts does not read its stdin
                while self._supervisor.receive(0.0) is not None:
                    pass  # ends that this stop has caused are no events
                self._remove_files()
                return
            # programs first: without the clock their packets would wait
            for names in ([NETWORK, *self._grounds], [PHYSICS], vehicles, [RADIO, PREFORK]):
                if names is vehicles and PREFORK in self._found:
                    self._supervisor.continue_or_kill(PREFORK, after_forks_s=ENDS_LIMIT_S)
                forced += self._supervisor.end(names, grace_s=STOP_LIMIT_S)
            self.forced = (*forced, *self._supervisor.stop())
            self._remove_files()
            self.drain()
            kept = sorted((PHYSICS, RADIO, NETWORK), key=lambda name: name not in self._found)  # causes first
            self.records_lost = next(filter(None, map(self._incomplete, kept)), None)
            if self.records_lost is not None:
                self.note_failure(self.records_lost)

    def _remove_files(self) -> None:
        with contextlib.suppress(OSError):
            self._folder.network.unlink()
        if self._radio is not None:
            self._radio.remove()
        if self._has_claim:
            external_autopilots.remove_files(self._scenario)

    def _incomplete(self, name: str) -> str | None:
        """Return a line if a process became ready but ended without writing all its data, else None."""
        if name not in self.ready:
            return None
        exited = self.exited.get(name)
        if exited is None:
            return f"{name} does not end"
        if exited.returncode != 0:
            return self._descriptions[name]
        return None if name in self.finished else f"{exited.describe()}, but did not finish"

    def kill(self, instance: int) -> None:
        """SIGKILL a vehicle's process or processes; returns when they have ended."""
        self._supervisor.kill(uav(instance))
        if instance in self._applications:
            self._supervisor.kill(application(instance))
        if self._folder.has_live_records:  # the tables are those of a run without
            cut_to_blocks(
                self._folder.raw_vehicle(instance), vehicle_record(self._folder.applications().columns)
            )
        self.drain()

    def send(self, command: AnyCommand) -> None:
        """Send the physics server a command. Raises SwarmError if it cannot receive one."""
        if not self._running or PHYSICS not in self.ready:  # too early: not a failure of the run
            raise SwarmError("the swarm is not running")
        try:
            self._supervisor.send(PHYSICS, command)
        except SupervisorError as error:
            raise self.fatal(SwarmError(str(error))) from None

    def leftovers(self) -> list[str]:
        """Return a line for each process, port and file that is left after the stop."""
        left = [
            f"{process.name()} (pid {process.pid}) of {name}" for process, name in self._supervisor.strays()
        ]
        # after their end only this process can still hold one of their ports
        held = {c.laddr.port for c in psutil.Process().net_connections("inet") if c.laddr}
        files = [] if self._radio is None else map(str, self._radio.leftovers())
        return [*left, *(f"port {port}" for port in sorted(held & self._ports)), *files]

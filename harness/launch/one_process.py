"""A whole swarm in one process, for campaigns: the same messages without sockets, Zenoh or pipes.

    summary = fly(load("scenarios/article.toml", ["run.seed=7"]), Path("runs/seed-7"))

    with OneProcessSwarm("scenarios/article.toml", agents=4, overrides=["formation.columns=2"]) as swarm:
        swarm.run_until_formed(timeout_s=120)
        swarm.degrade_channel(20.0)
        swarm.run_for(10)

Equal scenarios, seeds and interventions give byte-identical logs with `OneProcessSwarm` and `Swarm`. A flight
uses one processor, so one flight per processor can run in parallel, each in its own process:

    with ProcessPoolExecutor() as pool:
        summaries = pool.map(fly, scenarios, folders)

Ground stations, companions and guests of the radio cannot connect.
"""

import contextlib
import gc
import os
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from autopilot.parameters.config import VehicleConfig
from foundation.extension_call import FAILED_STATUS, watched
from foundation.extension_failure import ExtensionFailure
from foundation.kernels.use_cache import use_kernel_cache
from foundation.processes.child_protocol import Finished, Ready, Stop
from foundation.system_error import described
from harness.launch import external_autopilots, kernel_cache
from harness.launch.in_process_flight import InProcessFlight
from harness.launch.process_commands import PHYSICS, RADIO, uav
from harness.launch.processes import Processes
from harness.launch.run_messages import Message, SetupError, SwarmError, SwarmTimeoutError
from harness.launch.supervisor import ChildCommand, Exited, Supervisor
from harness.launch.swarm import Swarm
from harness.launch.swarm_settings import Speed
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.scenario.scenario import Scenario
from harness.simulator.messages import AnyCommand
from harness.simulator.server import obey
from harness.world.faults import AnyFault
from netsim.model.config import ServerConfig
from netsim.network.messages import StartPrograms

NAME = "one process"
"""Name of the process in manifest and logs."""
RUN_ID = "one-process"
"""Prefix of the radio's Zenoh keys, which are not used here."""
MANY = "use Swarm (in pytest: --coflight-processes many)"
"""Advice after a request that one process cannot fulfil."""
STOP_LIMIT_S = 10.0
"""Wall time that the flight has to end its step and write its data."""


class _ThreadSupervisor(Supervisor):
    """A supervisor with one child: a thread of this process that runs the whole flight."""

    def __init__(self, log_folder: Path) -> None:
        super().__init__(log_folder)
        self._inbox: queue.SimpleQueue[AnyCommand] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        """None also once the thread is abandoned, in a call that does not return."""
        self._flight: InProcessFlight | None = None
        self.error: Exception | None = None
        """Exception that ended the flight."""

    def launch(self, physics: PhysicsConfig, radio: ServerConfig, vehicles: Sequence[VehicleConfig]) -> None:
        """Start the thread, which composes the flight and waits for commands."""
        self._thread = threading.Thread(
            target=self._run, args=(physics, radio, vehicles), name="flight", daemon=True
        )
        self._thread.start()

    def _run(self, physics: PhysicsConfig, radio: ServerConfig, vehicles: Sequence[VehicleConfig]) -> None:
        code, last_words = 1, ""
        try:
            with contextlib.ExitStack() as stack:
                limit_s = physics.scenario.run.silence_limit_s
                stack.enter_context(watched(limit_s, on_stuck=self._on_stuck))
                self._flight = stack.enter_context(
                    contextlib.closing(
                        InProcessFlight(
                            physics, radio, vehicles, emit=self._emit_event, on_failure=self._on_failure
                        )
                    )
                )
                self._emit_event(PHYSICS, Ready(name=PHYSICS, pid=os.getpid()))
                self._fly(self._flight, physics.connect_timeout_s)
            code = 0
        except Exception as error:  # noqa: BLE001  logged, as a process logs its traceback
            self.error = error
            last_words = described(error)
            with contextlib.suppress(OSError):  # the disk may be full
                self.log_path(NAME).write_text(traceback.format_exc(), encoding="utf-8")
        finally:  # always report the end
            self._flight = None
            self._report_end(code, last_words)

    def _fly(self, flight: InProcessFlight, connect_timeout_s: float) -> None:
        """Execute commands until Stop."""
        simulation, emit = flight.simulation, partial(self._emit_event, PHYSICS)
        obey(simulation, self._inbox, connect_timeout_s=connect_timeout_s, emit=emit)
        details = {
            "time_us": simulation.time_us,
            "formed": simulation.reports.formed,
            RADIO: {"counters": flight.emulator.counters},
            **{link.host.name: link.counts() for link in flight.links},
        }
        emit(Finished(name=PHYSICS, details=details))

    def _report_end(self, code: int, last_words: str) -> None:
        ended = Exited(
            name=NAME, pid=os.getpid(), returncode=code, log_tail=last_words, last_words=last_words
        )
        self._received.put((PHYSICS, ended))

    def _on_stuck(self, line: str) -> None:
        """Report the end of a flight whose thread is in a call that cannot be ended, and abandon it."""
        self._thread = None
        self._report_end(FAILED_STATUS, f"{line} in one process; {MANY}")

    def _emit_event(self, name: str, event: Any) -> None:  # noqa: ANN401  any event
        self._received.put((name, event))

    def _on_failure(self, name: str, failure: ExtensionFailure) -> None:
        """Log the failure of the user's code on a vehicle, and queue its end, as of a vehicle's process."""
        line = f"uav: {failure}"
        with contextlib.suppress(OSError), self.log_path(name).open("a", encoding="utf-8") as log:
            traceback.print_exception(failure, file=log)
            log.write(line + "\n")
        ended = Exited(name=name, pid=os.getpid(), returncode=FAILED_STATUS, log_tail=line, last_words=line)
        self._received.put((name, ended))

    @property
    def pids(self) -> dict[str, int]:
        """Id of this process."""
        return {} if self._thread is None else {NAME: os.getpid()}

    def send(self, name: str, command: ChildCommand) -> None:  # noqa: ARG002  there is only one child
        """Send the flight a command."""
        if not isinstance(command, StartPrograms):  # there is no network in one process
            self._inbox.put(command)

    def kill(self, name: str, *, after_trace: bool = False) -> None:  # noqa: ARG002  it is no process
        """End a vehicle at once; the simulation reports it as lost in the next step."""
        if self._flight is not None:
            self._flight.kill(name)

    def end(
        self,
        names: Iterable[str],
        *,
        grace_s: float = 0.0,
        input_grace_s: float = 0.0,  # noqa: ARG002  it has no stdin
    ) -> list[str]:
        """End the flight if `PHYSICS` is among the names; returns a line if it does not end in time."""
        if PHYSICS not in names:
            return []
        self._inbox.put(Stop())  # also for an abandoned thread, whose call may return later
        thread = self._thread
        if thread is None:
            return []
        thread.join(grace_s or STOP_LIMIT_S)
        return ["the flight did not stop when asked"] if thread.is_alive() else []

    def stop(self, *, input_grace_s: float = 0.0) -> list[str]:  # noqa: ARG002  it has no stdin
        """End the flight for good."""
        return self.end([PHYSICS])


class _Processes(Processes):
    """The processes of a run as one thread of this process."""

    def _make_supervisor(self, folder: RunFolder) -> Supervisor:
        self._child = _ThreadSupervisor(folder.logs)
        return self._child

    def _start(self) -> None:
        scenario = self._scenario
        if self._external:
            kind = external_autopilots.TITLES[scenario.autopilot.kind]
            raise SetupError(f"autopilot.kind: {kind} is a process of its own, so one process cannot hold it")
        use_kernel_cache()
        kernel_cache.prepare(self._note, self._on_compiled)
        self._wall_start_s = time.monotonic()
        folder = self._folder
        radio = folder.radio_config(scenario, run_id=RUN_ID)
        folder.write_radio_config(scenario, radio)
        physics = _read(folder.write_physics_config(scenario, run_id=RUN_ID), PhysicsConfig)
        paths = [
            folder.write_vehicle_config(scenario, i, run_id=RUN_ID, simulator_port=0, radio_endpoint=None)
            for i in range(scenario.agents)
        ]
        vehicles = [_read(path, VehicleConfig) for path in paths]
        # exclude existing objects from garbage collections during the flight
        gc.collect()
        gc.freeze()
        self._child.launch(physics, radio, vehicles)
        self._await_ready([PHYSICS])

    def next(self, wall_limit_s: float, complaint: str) -> Message:
        """See `Processes.next`; the cause of a SwarmError is the exception that ended the flight."""
        try:
            return super().next(wall_limit_s, complaint)
        except SwarmError as error:
            raise error from self._child.error

    def stop(self, *, at_once: bool = False) -> None:
        """See `Processes.stop`; undoes the freeze of the garbage collector."""
        running = self._running
        super().stop(at_once=at_once)
        if running:
            gc.unfreeze()


def _read(path: Path, kind: type[Any]) -> Any:  # noqa: ANN401  an instance of ``kind``
    """Read a settings file, as a separate process does."""
    return msgspec.json.decode(path.read_bytes(), type=kind)


class OneProcessSwarm(Swarm):
    """A swarm in this process, with the interface of `Swarm` except `mavlink`.

    The simulation is a thread, so several swarms in one process share one processor.
    """

    _make_processes = _Processes

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        agents: int | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        speed: Speed = "max",
        out: str | Path | None = None,
        wall_limit_s: float | None = None,
        on_message: Callable[[Message], None] | None = None,
        live_records: bool = False,
    ) -> None:
        super().__init__(
            scenario,
            agents=agents,
            seed=seed,
            overrides=overrides,
            speed=speed,
            out=out,
            wall_limit_s=wall_limit_s,
            on_message=on_message,
            live_records=live_records,
        )

    def mavlink(self, instance: int, station: str | None = None) -> Any:  # noqa: ANN401, ARG002  see `Swarm`
        """Raise SwarmError: the vehicles have no links to the outside."""
        raise SwarmError(f"{uav(instance)} has no link to the outside in a swarm of one process: {MANY}")

    @property
    def addresses(self) -> tuple[str, ...]:
        """Raise SwarmError as `mavlink`."""
        raise SwarmError(f"there are no addresses in a swarm of one process: {MANY}")


def fly(
    scenario: Scenario,
    out: Path,
    *,
    until_s: float | None = None,
    faults_in_formation: Iterable[AnyFault] = (),
) -> dict[str, Any]:
    """Fly a scenario on one processor and return the summary of `harness.report.report.finish`.

    Flies until formed and then for ``run.duration_s``, as the command line does, or up to ``until_s``. The
    start times of ``faults_in_formation`` are relative to the instant at which it is formed. A formation that
    is not reached in time is a result with its own ``status``. Raises SwarmError for a failed run; OSError or
    MemoryError if the machine lacks disk space or memory.
    """
    try:
        with OneProcessSwarm(scenario, out=out) as swarm:
            if until_s is not None:
                swarm.run(until_s=until_s)
            else:
                with contextlib.suppress(SwarmTimeoutError):
                    if scenario.forms:
                        swarm.run_until_formed(timeout_s=scenario.run.reach_timeout_s)
                    for fault in faults_in_formation:
                        swarm.inject(fault)
                    swarm.run_for(scenario.run.duration_s)
            from harness.report import antenna_report  # noqa: PLC0415  the analysis is slow to import: not before the flight

            with antenna_report.on_threads(1):
                summary = swarm.summary(draw=False)
    except SwarmError as error:
        if isinstance(error.__cause__, OSError | MemoryError):
            raise error.__cause__ from None
        raise
    if summary["status"] == "failed":  # not only a timeout of the formation
        raise SwarmError(summary["reason"])
    return summary

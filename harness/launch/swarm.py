"""The Python API: a swarm of real processes under program control.

    with Swarm("scenarios/article.toml", agents=3, overrides=["formation.columns=2"]) as swarm:
        swarm.run_until_formed(timeout_s=60)
        swarm.cut_channel()
        swarm.run_for(10)
        assert swarm.truth.error_m.max() < 5.0

Simulated time passes only inside the ``run`` methods, so actions between them happen at an exact simulated
time, and the same program with the same seed gives the same flight. A swarm may be used by one thread at a
time, not necessarily the main one. Several swarms may fly at the same time.
"""

import contextlib
import shutil
import tempfile
import time
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import msgspec

from autopilot.onboard.factory import layout_of
from foundation.kernels.use_cache import use_kernel_cache
from foundation.profiling.profiler import KindProfile
from foundation.system_error import in_words
from harness.launch import ground_links, profiling
from harness.launch.interrupts import interrupts_deferred
from harness.launch.process_commands import application, uav
from harness.launch.processes import Processes
from harness.launch.run_course import RunCourse
from harness.launch.run_messages import (
    Message,
    ProcessNotice,
    RunEvent,
    SetupError,
    SwarmError,
    SwarmTimeoutError,
)
from harness.launch.swarm_settings import PortOffset, Ports, Speed, check_speed, speed_factor, with_ports
from harness.launch.truth import SwarmTruth
from harness.records.manifest import make_manifest, manifest_text
from harness.records.outcome import RunOutcome
from harness.records.run_folder import RunFolder
from harness.scenario import localisability
from harness.scenario.scenario import Scenario
from harness.scenario.scenario_file import load
from harness.simulator.messages import (
    ApplicationLost,
    InjectFault,
    Pause,
    Paused,
    Resume,
    RunUntil,
    SetAttenuation,
    SetSpeed,
    VehicleLost,
)
from harness.world.active_faults import MOST_ATTENUATION_DB
from harness.world.faults import AnyFault, UserFault, validated
from harness.world.user_models import fault_class

__all__ = ["SetupError", "Swarm", "SwarmError", "SwarmTimeoutError", "SwarmTruth"]

SILENCE_LIMIT_S = 180.0
"""Longest wall time without a message of the running physics server, whose own waits are much shorter."""
CUT_DB = 200.0
"""Attenuation that blocks all frames: a link budget has about 100 dB between transmitter and noise."""


class Swarm:
    """One run: its processes, its simulated time, its folder.

    ``scenario``: a file, changed by ``agents``, ``seed``, ``overrides`` (``"wind.mean_n=2"``); or a Scenario.
    ``speed``: simulated over wall time, or ``"max"``. ``out``: the run's folder; by default a temporary one,
    which is deleted with this object. ``ports``: ``"free"`` uses any free ports and sends to no ground
    station; ``"scenario"`` uses the scenario's ports, each plus ``port_offset``, which ``"auto"`` chooses: 0,
    or the first multiple of 1000 with which all ports are free. ``wall_limit_s``: run methods raise
    SwarmTimeoutError after this wall time since the start, in which the compilation of kernels does not
    count. ``on_message`` receives the messages of the processes and their ends, on the thread that runs the
    swarm, and before the first a warning if ranging does not determine the formation's shape.
    ``profile_from_s``: simulated time from which the processes are profiled, for `profile`. ``live_records``:
    the raw logs have each record at once, for a program that reads them in flight.

    Raises ScenarioError for an invalid scenario, SetupError for ``"max"`` with programs, which need wall
    time, and `foundation.kernels.cache_trust.UntrustedCache`.
    """

    _make_processes: ClassVar[type[Processes]] = Processes

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        agents: int | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        speed: Speed = "max",
        out: str | Path | None = None,
        ports: Ports = "free",
        port_offset: PortOffset = 0,
        wall_limit_s: float | None = None,
        on_message: Callable[[Message], None] | None = None,
        profile_from_s: float | None = None,
        live_records: bool = False,
    ) -> None:
        use_kernel_cache()  # the report's kernels run in this process
        if isinstance(scenario, Scenario):
            if agents is not None or seed is not None or overrides:
                raise ValueError(
                    "agents, seed and overrides change a scenario file; change a Scenario yourself"
                )
        else:
            named = {"agents": agents, "run.seed": seed}
            settings = [f"{path}={value}" for path, value in named.items() if value is not None]
            scenario = load(scenario, [*overrides, *settings])
        self.scenario = with_ports(scenario, ports, port_offset)
        self._speed = speed_factor(speed)
        check_speed(self.scenario, self._speed)
        if out is None:
            self.path = Path(tempfile.mkdtemp(prefix="coflight-"))
            weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
        else:
            self.path = Path(out)
        step_us = self.scenario.run.step_us
        # not before the first step is done: vehicles start until then
        from_us = None if profile_from_s is None else max(round(profile_from_s * 1e6), 2 * step_us)
        self._folder = RunFolder(self.path, profile_from_us=from_us, live_records=live_records)
        self._processes = self._make_processes(
            self.scenario,
            self._folder,
            wall_limit_s=wall_limit_s,
            on_message=on_message,
            search_ports=port_offset == "auto",
        )
        self._on_message = on_message or (lambda _: None)
        self._truth: SwarmTruth | None = None
        self._links = contextlib.ExitStack()
        self._course = RunCourse()
        self._stands = False
        self._is_flying = False
        """Whether it was started and not yet stopped."""
        self._has_flown = False
        self._summary: dict[str, Any] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        except KeyboardInterrupt:
            self.stop()  # Ctrl-C arrived before the stop deferred it
            raise

    def start(self) -> None:
        """Start every process and wait until every vehicle is connected.

        Simulated time is then that of the first step, ``run.step_us``: 0 would mean a clock that is not set.

        Raises SetupError, or SwarmError if a process does not become ready; then all are stopped again. The
        folder is kept only if a process has failed, for its log.
        """
        if self._course.has_begun:
            raise SwarmError("a swarm is started once")
        self._course.begin()
        if (text := localisability.warning(self.scenario)) is not None:
            self._on_message(ProcessNotice(text=text))
        self._folder.first_manifest = self._running_manifest()
        try:
            self._processes.start()
            self.scenario = self._processes.scenario
            try:
                self._folder.write_manifest(self._running_manifest())  # with the ports that are used
            except OSError as error:
                raise SetupError(in_words(error)) from None
            self._run(RunUntil(time_us=0))  # no simulation: waits for the vehicles to connect
            self._course.wall_running_s = 0.0
            self._is_flying = True
        except BaseException as error:
            self._processes.failure = str(error) or type(error).__name__
            with interrupts_deferred():
                self._processes.stop(at_once=True)
                is_failure = isinstance(error, SwarmError) and not isinstance(error, SetupError)
                if is_failure and any(self._folder.logs.glob("*")):
                    self._write_outcome()
                    self._folder.release()
                else:
                    self._folder.discard()
            raise

    def stop(self) -> None:
        """End every process; harmless when repeated. The records are kept for `summary`.

        Ctrl-C takes effect when all processes have ended and the manifest says how the run did.
        """
        try:
            self._links.close()
        finally:
            with interrupts_deferred():
                self._processes.stop()
                if self._is_flying:
                    self._is_flying, self._has_flown = False, True
                    self._write_outcome()

    # --- simulated time

    @property
    def truth(self) -> SwarmTruth:
        """True states of all vehicles when the last run method returned."""
        if self._truth is None:
            raise SwarmError("the swarm has not been started")
        return self._truth

    def run(self, *, until_s: float) -> SwarmTruth:
        """Fly up to a simulated time. Raises SwarmError if that cannot be reached."""
        return self._run(RunUntil(time_us=round(until_s * 1e6), speed=self._speed))

    def run_for(self, duration_s: float) -> SwarmTruth:
        """Fly for a simulated time. Raises SwarmError."""
        return self._run(RunUntil(time_us=self._after_us(duration_s), speed=self._speed))

    def run_until_formed(self, *, timeout_s: float) -> SwarmTruth:
        """Fly until every application has reached its aim; of the formation, until all are on station.

        Raises SwarmTimeoutError, and SwarmError for an application without an aim.
        """
        onboard = self.scenario.onboard
        if onboard.enabled and not layout_of(onboard).formed:
            raise SwarmError(
                f"onboard.application {onboard.application} reports no phase in which it has formed; "
                "use run or run_until"
            )
        deadline_us = self._after_us(timeout_s)
        truth = self._run(RunUntil(time_us=deadline_us, stop_when_formed=True, speed=self._speed))
        if self._processes.formed_us is None:
            self._course.not_formed = f"the formation was not reached within {timeout_s:g} s"
            raise SwarmTimeoutError(self._course.not_formed)
        self._course.not_formed = None
        return truth

    def run_until(
        self, condition: Callable[[SwarmTruth], bool], *, timeout_s: float, every_s: float = 0.02
    ) -> SwarmTruth:
        """Fly until the condition holds; returns the truth for which it held. Raises SwarmTimeoutError.

        It is evaluated at once, and then at every simulated time that is a multiple of ``every_s``, itself a
        multiple of the step, so the result depends only on the flight.
        """
        every_us, step_us = round(every_s * 1e6), self.scenario.run.step_us
        if every_us <= 0 or every_us % step_us:
            raise ValueError(f"every_s {every_s:g}: expected a multiple of the step, {step_us} us")
        truth, deadline_us = self.truth, self._after_us(timeout_s)
        while not condition(truth):
            if truth.time_us >= deadline_us:
                raise SwarmTimeoutError(f"the condition was not met within {timeout_s:g} s")
            next_us = (truth.time_us // every_us + 1) * every_us
            truth = self._run(RunUntil(time_us=min(next_us, deadline_us), speed=self._speed))
        return truth

    def pause(self) -> None:
        """Pause simulated time in the present or next run, from any thread.

        Vehicles continue to send heartbeats to ground stations and to answer their commands. The logs are the
        same as without a pause. Raises SwarmError if the swarm is not running.
        """
        self._processes.send(Pause())
        self._stands = True

    def resume(self) -> None:
        """Continue after `pause`, from any thread. Raises SwarmError."""
        self._processes.send(Resume())
        self._stands = False

    @property
    def stands(self) -> bool:
        """Whether the swarm is paused."""
        return self._stands

    @property
    def simulated_s(self) -> float:
        """Simulated time that was reported last, also during a run."""
        return self._processes.simulated_us * 1e-6

    @property
    def speed(self) -> Speed:
        """Requested speed: simulated over wall time."""
        return self._speed or "max"

    def set_speed(self, speed: Speed) -> None:
        """Fly at another speed from now on, from any thread. Raises SwarmError."""
        factor = speed_factor(speed)
        check_speed(self.scenario, factor)
        self._speed = factor
        self._processes.send(SetSpeed(speed=self._speed))

    def _after_us(self, duration_s: float) -> int:
        return self.truth.time_us + round(duration_s * 1e6)

    def _run(self, command: RunUntil) -> SwarmTruth:
        processes = self._processes
        processes.drain()
        if processes.failure is not None:
            raise SwarmError(processes.failure)
        processes.send(command)
        wall_begin_s = time.monotonic()
        processes.wall_paused_s = 0.0
        try:
            with processes.progress_awaited():
                paused = self._await_paused()
        except BaseException as error:
            # the simulated time reached depends on the machine: the run cannot be continued
            processes.note_failure(self._course.break_off(error))
            raise
        finally:
            # after an error this is the pause that the physics server reported last
            self._course.wall_running_s += time.monotonic() - wall_begin_s - processes.wall_paused_s
        self._truth = SwarmTruth(time_us=paused.time_us, vehicles=paused.vehicles)
        if paused.reason in ("no_vehicles", "vehicle_lost"):
            processes.find_cause()
            if processes.failure is not None:
                raise SwarmError(processes.failure)
        if paused.reason == "no_vehicles":
            left = f"no vehicle is left at {self._truth.t_s:.3f} s"
            raise processes.fatal(SwarmError("; ".join([left, *processes.failed_processes()[-1:]])))
        if paused.reason == "vehicle_lost":
            lost = "; ".join(
                f"{uav(event.instance) if isinstance(event, VehicleLost) else application(event.instance)} "
                f"was lost: {event.reason}"
                for event in processes.events
                if isinstance(event, VehicleLost | ApplicationLost)
            )
            raise processes.fatal(SwarmError(f"{lost}; run.on_vehicle_loss is 'end'"))
        return self._truth

    def _await_paused(self) -> Paused:
        while True:
            message = self._processes.next(SILENCE_LIMIT_S, "the physics server is silent")
            if isinstance(message, Paused):
                return message

    # --- interventions

    def kill(self, instance: int) -> None:
        """SIGKILL a vehicle's process now; returns when it has ended."""
        self._intervene(f"kill uav {instance}")
        self._course.killed.add(instance)
        self._processes.kill(instance)

    def cut_channel(self) -> None:
        """Block all frames from the next interval of the radio channel on (the applications' loop period)."""
        self._attenuate(CUT_DB, "cut the channel")

    def degrade_channel(self, attenuation_db: float) -> None:
        """Set every link's attenuation instead of ``radio.extra_attenuation_db``; begins as `cut_channel`.

        Raises ValueError outside 0 to `harness.world.faults.MOST_ATTENUATION_DB`.
        """
        if not 0.0 <= attenuation_db <= MOST_ATTENUATION_DB:  # also false for nan
            raise ValueError(f"attenuation_db {attenuation_db:g}: expected 0 to {MOST_ATTENUATION_DB:g} dB")
        self._attenuate(attenuation_db, f"attenuate the channel by {attenuation_db:g} dB")

    def restore_channel(self) -> None:
        """Restore the scenario's attenuation; begins as `cut_channel`."""
        self._attenuate(self.scenario.radio.extra_attenuation_db, "restore the channel")

    def _attenuate(self, attenuation_db: float, what: str) -> None:
        self._intervene(what)
        self._processes.send(SetAttenuation(extra_attenuation_db=attenuation_db))

    def inject(self, fault: AnyFault) -> None:
        """Inject a fault from the next step on, or ``fault.start_s`` later; of radios as `cut_channel`.

        Raises ValueError for an invalid fault.
        """
        fault = validated(fault, self.scenario.rotors(), other_compasses=self.scenario.ardupilots)
        if isinstance(fault, UserFault):
            fault = msgspec.structs.replace(fault, folder=str(Path(fault.folder).resolve()))
            fault_class(fault, "fault")
        self._intervene(f"inject {msgspec.json.encode(fault).decode()}")
        self._processes.send(InjectFault(fault=fault))

    def _intervene(self, what: str) -> None:
        self._course.interventions.append(f"{self.truth.t_s:.3f} s: {what}")

    def mavlink(self, instance: int, station: str | None = None) -> Any:  # noqa: ANN401  pymavlink has no types
        """Open a pymavlink connection (`mavutil`) to a vehicle, as a ground station; closed with the swarm.

        With ``links.telemetry = "radio"`` or "serial-radio" it is that of the ground station of this name, by
        default the first.

        A vehicle answers the stations that have sent to it, so a first heartbeat is sent here. It also
        answers while simulated time is paused, but its streams follow simulated time. Such a run depends on
        more than scenario and seed, which its manifest states. The connection signs if the scenario has a
        key.
        """
        port = ground_links.local_port(self.scenario, self._processes.ready, instance, station)
        link = ground_links.connect(self.scenario.links, port)
        self._links.callback(link.close)
        return link

    # --- what happened

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name: ``physics``, ``radio``, ``uav 0`` ..."""
        return self._processes.pids

    @property
    def addresses(self) -> tuple[str, ...]:
        """A line for each vehicle with its MAVLink addresses, once the swarm is started."""
        return ground_links.link_lines(self.scenario, self._processes.ready)

    @property
    def events(self) -> tuple[RunEvent, ...]:
        """Events of the run in order: vehicles lost, collisions, the formation reached, processes ended."""
        self._processes.drain()
        return tuple(self._processes.events)

    @property
    def forced(self) -> tuple[str, ...]:
        """After the stop, a line for each process that had to be forced to end."""
        return self._processes.forced

    @property
    def records_lost(self) -> str | None:
        """After the stop, why the records of physics or radio are incomplete; None: they are complete."""
        return self._processes.records_lost

    @property
    def has_records(self) -> bool:
        """Whether the flight has begun, so that raw logs or results of it are in its folder."""
        return self._is_flying or self._has_flown

    def log_tails(self, lines: int) -> dict[str, str]:
        """Return the last lines of each process's log, by name."""
        return self._processes.log_tails(lines)

    @property
    def profile(self) -> dict[str, KindProfile]:
        """After the stop, the profile by kind of process; empty without ``profile_from_s``."""
        return profiling.by_kind(self._processes.finished)

    def leftovers(self) -> list[str]:
        """Return, after the stop, a line for each running process and each port of this swarm: none."""
        return self._processes.leftovers()

    def summary(self, *, draw: bool = True, interrupted: bool = False, held: bool = False) -> dict[str, Any]:
        """Stop, write tables, manifest, summary and, with ``draw``, figures; returns the summary.

        ``interrupted`` marks a run that its user interrupted before its end, ``held`` one without an end,
        which its user ended. Raises OSError if the folder cannot be written.
        """
        if self._summary is not None:
            return self._summary
        self.stop()
        if self._folder.is_reported():  # an earlier call has failed to draw the figures
            self._summary = msgspec.json.decode(self._folder.summary.read_bytes(), type=dict[str, Any])
            return self._summary
        if interrupted:
            self._course.break_off(KeyboardInterrupt())
        ended = self._write_outcome(held=held)
        with interrupts_deferred():  # libraries convert the exception of a signal in their imports
            from harness.report import report  # noqa: PLC0415  slow to import: not before the flight

        try:
            if not interrupted and not held:
                self._processes.prepare_report()
            with self._folder.held():
                self._summary = report.finish(self._folder, self.scenario, ended, draw=draw)
        finally:
            self._folder.release()  # also for ``coflight report``, after an error
        return self._summary

    def _running_manifest(self) -> bytes:
        """Return the manifest of a run whose end is not known yet."""
        return manifest_text(make_manifest(self.scenario, self._course.running(speed=self._speed)))

    def _write_outcome(self, *, held: bool = False) -> RunOutcome:
        """Write how the flight ended into the manifest, for ``coflight report``, and return it."""
        ended = self._course.ended(self._processes, speed=self._speed, held=held)
        with interrupts_deferred(), contextlib.suppress(OSError):  # on a full disk that of the start is kept
            self._folder.write_manifest(manifest_text(make_manifest(self.scenario, ended)))
        return ended

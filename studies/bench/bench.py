"""Measure floors and flights alternately, for equal conditions, and summarise them by medians.

Each runs in a separate process. The repeats measure real-time factor, processor time by kind of process,
memory and start-up time; one additional flight with a sampling profiler measures the shares of the parts.
"""

import contextlib
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import TypeVar

import msgspec
import psutil
from msgspec import Struct

from harness.launch import kernel_cache
from harness.launch.interrupts import interrupts_deferred
from harness.launch.profiling import VEHICLES
from studies.bench.flight_job import FlightCost, FlightJob
from studies.bench.floor_job import FloorCost, FloorJob

SCENARIOS = Path(__file__).parents[2] / "scenarios"
FEW = 8
"""Largest number of UAVs for which the default is the article's scenario."""
WALL_LIMIT_S = 1_800.0
"""Time limit of one flight or floor; it is exceeded only on a machine unsuitable for measurements."""
END_LIMIT_S = 90.0
"""Time limit for the end of an interrupted measurement: a swarm takes at most a minute to stop."""

Result = TypeVar("Result", bound=Struct)
Parts = dict[str, dict[str, float]]


class BenchError(Exception):
    """A measurement failed; the text is one line."""


class BenchPlan(Struct, frozen=True, kw_only=True):
    """Parameters of the benchmark."""

    agents: tuple[int, ...]
    duration_s: float
    """Simulated time in formation"""
    repeats: int
    floor_wall_s: float
    """Wall time of each of the two floors in each repetition"""
    scenario: Path | None = None
    """None: the article's scenario for up to `FEW` UAVs, a large swarm's for more"""
    seed: int = 1

    def scenario_for(self, agents: int) -> Path:
        """Return the path of the scenario for this number of UAVs."""
        if self.scenario is not None:
            return self.scenario
        return SCENARIOS / ("article.toml" if agents <= FEW else "swarm64.toml")


class HostMachine(Struct, frozen=True, kw_only=True):
    """Hardware and software of the machine."""

    processors: int
    model: str
    memory_gb: float
    system: str
    python: str
    """Version and build"""
    load: float
    """Load average over the minute before the start"""


class BenchRun(Struct, frozen=True, kw_only=True):
    """Cost of a swarm of one size; medians of the repeats unless stated otherwise."""

    agents: int
    scenario: str
    real_time_factor: float
    """In formation"""
    whole_real_time_factor: float
    """From the first step on, including take-off"""
    floor_real_time_factor: float
    """Of bare processes in lockstep"""
    echo_real_time_factor: float
    """Of bare processes that exchange as many bytes"""
    cpu_s_per_simulated_s: dict[str, float]
    """In formation, by kind of process"""
    floor_cpu_s_per_simulated_s: float
    parts_cpu_s_per_simulated_s: Parts
    """By kind and part: the processor time above, split by the shares of the profiled flight"""
    waiting_fraction: dict[str, float]
    """Idle share of wall time, by kind, mean over processes in the profiled flight"""
    queueing_fraction: dict[str, float]
    """Share of wall time waiting for a processor, likewise"""
    uss_mb_per_uav: float
    uss_mb: dict[str, float]
    """Of one process, by kind"""
    pss_mb: float
    """Of all processes, shared memory counted once"""
    startup_s: float
    """From the launch to the end of the first step"""
    formed_s: float | None
    """Simulated time at which the formation was reached; None if no repeat reached it in time"""
    other_processors: float
    """Processors busy with other processes: largest value of the repeats"""
    flights: tuple[FlightCost, ...]
    """Every repeat"""
    floors: tuple[FloorCost, ...]


class FlightBench(Struct, frozen=True, kw_only=True):
    """Results of the benchmark."""

    machine: HostMachine
    duration_s: float
    repeats: int
    runs: tuple[BenchRun, ...]
    failure: str | None = None
    """Reason if runs are missing."""
    broken_off: bool = False
    """Whether the user interrupted it."""


def bench(plan: BenchPlan, note: Callable[[str], None]) -> FlightBench:
    """Run the benchmark; ``note`` is called with progress messages.

    Results from before a failure or Ctrl-C are returned with the reason of the failure. Raises BenchError or
    KeyboardInterrupt if there are none, and CompileError for the kernels.
    """
    kernel_cache.prepare(note)
    machine = this_machine()
    runs: list[BenchRun] = []
    failure, broken_off = None, False
    for agents in plan.agents:
        try:
            runs.append(_run(plan, agents, note))
        except (BenchError, KeyboardInterrupt) as error:
            if not runs:
                raise
            broken_off = isinstance(error, KeyboardInterrupt)
            failure = f"{_uavs(agents)}: {'interrupted' if broken_off else error}"
            break
    return FlightBench(
        machine=machine, duration_s=plan.duration_s, repeats=plan.repeats, runs=tuple(runs), failure=failure,
        broken_off=broken_off,
    )  # fmt: skip


def _run(plan: BenchPlan, agents: int, note: Callable[[str], None]) -> BenchRun:
    floors, flights = [], []
    for repeat in range(plan.repeats):
        floors.append(_floor(agents, plan.floor_wall_s))
        flights.append(_flight(plan, agents))
        note(
            f"{_uavs(agents)}, {repeat + 1} of {plan.repeats}:"
            f" {flights[-1].steady.real_time_factor:.2f} x real time,"
            f" floor {floors[-1].lockstep.real_time_factor:.1f} x,"
            f" {flights[-1].steady.other_processors:.1f} processors busy with other processes"
        )
    formed_s = next((flight.formed_s for flight in flights if flight.formed_s is not None), None)
    profiled = _flight(plan, agents, profile_from_s=formed_s or 0.0)
    note(f"{_uavs(agents)}: profile: {profiled.steady.real_time_factor:.2f} x real time")
    return summarise(
        agents, plan.scenario_for(agents).name, floors=floors, flights=flights, profiled=profiled
    )


def _uavs(agents: int) -> str:
    return "1 UAV" if agents == 1 else f"{agents} UAVs"


def summarise(
    agents: int,
    scenario: str,
    *,
    floors: Sequence[FloorCost],
    flights: Sequence[FlightCost],
    profiled: FlightCost,
) -> BenchRun:
    """Return medians of the repeats, and processor time by part with the shares of the profiled flight."""
    cpu_s = _medians([flight.steady.cpu_s_per_simulated_s for flight in flights])
    uss_mb = _medians([flight.uss_mb for flight in flights])
    formed_s = [flight.formed_s for flight in flights if flight.formed_s is not None]
    return BenchRun(
        agents=agents,
        scenario=scenario,
        real_time_factor=median(flight.steady.real_time_factor for flight in flights),
        whole_real_time_factor=median(flight.whole.real_time_factor for flight in flights),
        floor_real_time_factor=median(floor.lockstep.real_time_factor for floor in floors),
        echo_real_time_factor=median(floor.echo.real_time_factor for floor in floors),
        cpu_s_per_simulated_s=cpu_s,
        floor_cpu_s_per_simulated_s=median(
            floor.lockstep.server_cpu_s_per_simulated_s + floor.lockstep.vehicles_cpu_s_per_simulated_s
            for floor in floors
        ),
        parts_cpu_s_per_simulated_s={
            kind: {
                part: cpu_s[kind] * spent / of_kind.cpu_s_per_simulated_s
                for part, spent in of_kind.parts_cpu_s_per_simulated_s.items()
            }
            for kind, of_kind in profiled.profile.items()
            if of_kind.cpu_s_per_simulated_s > 0.0
        },
        waiting_fraction={kind: of_kind.waiting_fraction for kind, of_kind in profiled.profile.items()},
        queueing_fraction={kind: of_kind.queueing_fraction for kind, of_kind in profiled.profile.items()},
        uss_mb_per_uav=uss_mb[VEHICLES],
        uss_mb=uss_mb,
        pss_mb=median(flight.pss_mb for flight in flights),
        startup_s=median(flight.startup_s for flight in flights),
        formed_s=median(formed_s) if formed_s else None,
        other_processors=max(flight.steady.other_processors for flight in flights),
        flights=tuple(flights),
        floors=tuple(floors),
    )


def _medians(by_kind: Sequence[dict[str, float]]) -> dict[str, float]:
    return {kind: median(each.get(kind, 0.0) for each in by_kind) for kind in by_kind[0]}


def _floor(agents: int, wall_s: float) -> FloorCost:
    return measured("studies.bench.floor", FloorJob(agents=agents, wall_s=wall_s), FloorCost)


def _flight(plan: BenchPlan, agents: int, *, profile_from_s: float | None = None) -> FlightCost:
    # created here, so that it is removed even if the flight's launcher is killed
    with tempfile.TemporaryDirectory(prefix="coflight-bench-", ignore_cleanup_errors=True) as folder:
        job = FlightJob(
            scenario=str(plan.scenario_for(agents)), agents=agents, seed=plan.seed,
            duration_s=plan.duration_s, folder=f"{folder}/run", wall_launched_s=time.monotonic(),
            profile_from_s=profile_from_s,
        )  # fmt: skip
        return measured("studies.bench.flight", job, FlightCost)


def measured(module: str, job: Struct, kind: type[Result]) -> Result:
    """Run a measurement in a separate process that ends with this one. Raises BenchError."""
    command = [sys.executable, "-P", "-m", module, msgspec.json.encode(job).decode()]
    with contextlib.ExitStack() as stack:
        output, errors = (stack.enter_context(tempfile.TemporaryFile("w+")) for _ in range(2))
        with interrupts_deferred():
            process = subprocess.Popen(
                command,
                env=os.environ | kernel_cache.environment(),
                stdin=subprocess.PIPE,  # closed when this process ends, for any reason
                stdout=output,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is reported once, by this process
            )
            stack.callback(_end, process)
        try:
            status = process.wait(WALL_LIMIT_S)
        except subprocess.TimeoutExpired:
            raise BenchError(f"{module}: not done within {WALL_LIMIT_S:g} s") from None
        if status:
            errors.seek(0)
            last_line = errors.read().strip().rpartition("\n")[2]
            raise BenchError(last_line or f"{module} ended with status {status}")
        output.seek(0)
        # PyBullet may print its build time first
        return msgspec.json.decode(output.read().strip().rpartition("\n")[2], type=kind)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Interrupt a measurement, unless it has ended, and wait for its end."""
    with process, interrupts_deferred():
        process.send_signal(signal.SIGINT)
        try:
            process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()


def this_machine() -> HostMachine:
    """Return the hardware and software of this machine."""
    return HostMachine(
        processors=len(psutil.Process().cpu_affinity()) if sys.platform == "linux" else os.cpu_count() or 1,
        model=_processor_model(),
        memory_gb=round(psutil.virtual_memory().total / 1e9, 1),
        system=platform.platform(),
        python=f"{platform.python_version()} of {sys.base_prefix}",
        load=round(os.getloadavg()[0], 2),
    )


def _processor_model() -> str:
    """Return the name of the processor, if the system reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def to_json(found: FlightBench) -> str:
    """Return the results as JSON."""
    return msgspec.json.format(msgspec.json.encode(found), indent=2).decode()

"""One flight that is measured, in a launcher of its own: ``python -m harness.bench.flight``.

It is the launcher of a user's run: start-up, memory and processor time are those of `harness.swarm.Swarm` and
its processes. Everything is read between two run methods, while simulated time stands.
"""

import os
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import psutil
from msgspec import Struct

from harness.processes import PHYSICS, RADIO, SwarmError
from harness.profiling import VEHICLES, KindProfile, kind_of
from harness.scenario import ScenarioError, load
from harness.swarm import Swarm, SwarmTimeoutError

LAUNCHER = "launcher"
_MB = 1e6


class FlightJob(Struct, frozen=True, kw_only=True):
    """What is to be flown."""

    scenario: str
    agents: int
    seed: int
    duration_s: float
    """After the formation is reached"""
    folder: str
    """For what the flight writes; not there yet"""
    wall_launched_s: float
    """By `time.monotonic`, which all processes of a machine share"""
    profile_from_s: float | None = None


class Span(Struct, frozen=True, kw_only=True):
    """A stretch of a flight."""

    simulated_s: float
    wall_s: float
    cpu_s_per_simulated_s: dict[str, float]
    """By kind of process"""
    other_processors: float
    """That were busy with what is not of the flight, on average: 0 on a quiet machine"""

    @property
    def real_time_factor(self) -> float:
        """Simulated against wall time."""
        return self.simulated_s / self.wall_s


class FlightCost(Struct, frozen=True, kw_only=True):
    """What the flight cost."""

    startup_s: float
    """From the launch to the end of the first step"""
    formed_s: float | None
    """Simulated time at which the formation was reached; None: it was not in time"""
    whole: Span
    """From the first step on"""
    steady: Span
    """From the formation, or the limit for it, on"""
    uss_mb: dict[str, float]
    """Memory that goes with the process, by kind, a process's median, at the end"""
    profile: dict[str, KindProfile]


class _Mark(Struct, frozen=True):
    """All clocks at an instant of simulated time."""

    simulated_s: float
    wall_s: float
    cpu_s: dict[str, float]
    machine_cpu_s: float


def fly(job: FlightJob) -> FlightCost:
    """Fly and measure. Raises ScenarioError or SwarmError."""
    scenario = load(Path(job.scenario), [f"agents={job.agents}", f"run.seed={job.seed}"])
    step_s = scenario.run.step_us * 1e-6
    swarm = Swarm(scenario, out=job.folder, profile_from_s=job.profile_from_s)
    with swarm:
        swarm.run(until_s=2.0 * step_s)  # the clock begins at one step
        startup_s = time.monotonic() - job.wall_launched_s
        first = _mark(swarm)
        formed_s = None
        try:
            formed_s = swarm.run_until_formed(timeout_s=scenario.run.reach_timeout_s).t_s
        except SwarmTimeoutError:
            if swarm.simulated_s < scenario.run.reach_timeout_s:  # it was not the formation that was late
                raise
        formed = _mark(swarm)
        swarm.run_for(job.duration_s)
        last = _mark(swarm)
        uss_mb = _uss_mb(swarm)
    return FlightCost(
        startup_s=startup_s,
        formed_s=formed_s,
        whole=_span(first, last),
        steady=_span(formed, last),
        uss_mb=uss_mb,
        profile=swarm.profile,
    )


def _mark(swarm: Swarm) -> _Mark:
    cpu_s = {LAUNCHER: _cpu_s(os.getpid())}
    for name, pid in swarm.pids.items():
        kind = kind_of(name)
        cpu_s[kind] = cpu_s.get(kind, 0.0) + _cpu_s(pid)
    machine = psutil.cpu_times()
    # not what guests of this machine use: it is in the others
    machine_cpu_s = machine.user + machine.nice + machine.system
    return _Mark(swarm.simulated_s, time.monotonic(), cpu_s, machine_cpu_s)


def _cpu_s(pid: int) -> float:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return float(times.user + times.system)


def _span(begin: _Mark, end: _Mark) -> Span:
    simulated_s, wall_s = end.simulated_s - begin.simulated_s, end.wall_s - begin.wall_s
    spent_s = {kind: end.cpu_s[kind] - begin.cpu_s.get(kind, 0.0) for kind in end.cpu_s}
    others_s = end.machine_cpu_s - begin.machine_cpu_s - sum(spent_s.values())
    return Span(
        simulated_s=simulated_s,
        wall_s=wall_s,
        cpu_s_per_simulated_s={kind: spent / simulated_s for kind, spent in spent_s.items()},
        other_processors=max(0.0, others_s / wall_s),
    )


def _uss_mb(swarm: Swarm) -> dict[str, float]:
    found: dict[str, list[float]] = {LAUNCHER: [_own_uss_mb(os.getpid())]}
    for name, pid in swarm.pids.items():
        found.setdefault(kind_of(name), []).append(_own_uss_mb(pid))
    return {kind: statistics.median(values) for kind, values in found.items()}


def _own_uss_mb(pid: int) -> float:
    return float(psutil.Process(pid).memory_full_info().uss) / _MB


KINDS = (PHYSICS, RADIO, VEHICLES, LAUNCHER)
"""In the order in which they are told; others, if there are any, come after them."""


def main(arguments: Sequence[str]) -> int:
    """Fly what the one argument, a `FlightJob` in JSON, says; the cost is the last line on stdout."""
    try:
        cost = fly(msgspec.json.decode(arguments[0], type=FlightJob))
    except (ScenarioError, SwarmError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(msgspec.json.encode(cost).decode() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

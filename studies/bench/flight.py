"""Measure one flight in a separate launcher: ``python -m studies.bench.flight``.

The launcher is the same as for a user's run: start-up, memory and processor time are those of
`harness.launch.swarm.Swarm` and its processes. All clocks are read between calls of run methods, while
simulated time is stopped.
"""

import os
import signal
import statistics
import sys
import threading
import time
from collections.abc import Collection, Sequence
from pathlib import Path

import msgspec
import psutil
from msgspec import Struct

from foundation.exit_status import BAD_INPUT, FINE, INTERRUPTED
from harness.launch import px4
from harness.launch.interrupts import interruptible
from harness.launch.process_commands import application, uav
from harness.launch.profiling import kind_of
from harness.launch.run_messages import SwarmError
from harness.launch.swarm import Swarm, SwarmTimeoutError
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from harness.simulator.messages import ApplicationLost, VehicleLost
from studies.bench.flight_job import LAUNCHER, FlightCost, FlightJob, Span

_MB = 1e6


class _Mark(Struct, frozen=True):
    """All clocks at an instant of simulated time."""

    simulated_s: float
    wall_s: float
    cpu_s: dict[str, float]
    machine_cpu_s: float


def fly(job: FlightJob) -> FlightCost:
    """Fly and measure. Raises ScenarioError or SwarmError."""
    scenario = load(Path(job.scenario), [f"agents={job.agents}", f"run.seed={job.seed}", *job.settings])
    step_s = scenario.run.step_us * 1e-6
    swarm = Swarm(
        scenario, out=job.folder, profile_from_s=job.profile_from_s,
        # a PX4's ports follow from its instance number
        ports="scenario" if px4.instances(scenario) else "free",
        port_offset="auto" if px4.instances(scenario) else 0,
    )  # fmt: skip
    with swarm:
        swarm.run(until_s=2.0 * step_s)  # simulated time starts at one step
        startup_s = time.monotonic() - job.wall_launched_s
        first = _mark(swarm)
        formed_s = None
        try:
            formed_s = swarm.run_until_formed(timeout_s=scenario.run.reach_timeout_s).t_s
        except SwarmTimeoutError:
            if swarm.simulated_s < scenario.run.reach_timeout_s:  # not the limit of the formation
                raise
        formed = _mark(swarm)
        swarm.run_for(job.duration_s)
        _check_complete(swarm)
        last = _mark(swarm)
        uss_mb, pss_mb = _memory_mb(swarm)
    return FlightCost(
        startup_s=startup_s, formed_s=formed_s, whole=_span(first, last), steady=_span(formed, last),
        uss_mb=uss_mb, pss_mb=pss_mb, profile=swarm.profile,
    )  # fmt: skip


def _check_complete(swarm: Swarm) -> None:
    """Check that no vehicle was lost, because a smaller swarm costs less. Raises SwarmError."""
    for event in swarm.events:
        if isinstance(event, VehicleLost):
            raise SwarmError(f"{uav(event.instance)} was lost: {event.reason}")
        if isinstance(event, ApplicationLost):
            raise SwarmError(f"{application(event.instance)} was lost: {event.reason}")


def _mark(swarm: Swarm) -> _Mark:
    own = psutil.Process().cpu_times()
    cpu_s = {LAUNCHER: float(own.user + own.system)}
    pids = swarm.pids
    for name, pid in pids.items():
        kind = kind_of(name)
        cpu_s[kind] = cpu_s.get(kind, 0.0) + _cpu_s(pid, without=set(pids.values()))
    machine = psutil.cpu_times()
    machine_cpu_s = machine.user + machine.nice + machine.system
    return _Mark(swarm.simulated_s, time.monotonic(), cpu_s, machine_cpu_s)


def _cpu_s(pid: int, without: Collection[int]) -> float:
    """Return the processor time of a process and of its children, such as a PX4, ``without`` those."""
    process = psutil.Process(pid)
    children = [child for child in process.children(recursive=True) if child.pid not in without]
    times = [each.cpu_times() for each in (process, *children)]
    return float(sum(each.user + each.system for each in times))


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


def _memory_mb(swarm: Swarm) -> tuple[dict[str, float], float]:
    """Return the USS of a process by kind, and the PSS of all processes."""
    uss_mb: dict[str, list[float]] = {}
    pss_mb = 0.0
    for name, pid in {LAUNCHER: os.getpid(), **swarm.pids}.items():
        memory = psutil.Process(pid).memory_full_info()
        uss_mb.setdefault(kind_of(name), []).append(memory.uss / _MB)
        pss_mb += getattr(memory, "pss", memory.uss) / _MB
    return {kind: statistics.median(values) for kind, values in uss_mb.items()}, pss_mb


def _interrupt_with_parent() -> None:
    """Start a thread that interrupts this process when stdin ends, because its parent has ended."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4_096):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=wait, name="parent", daemon=True).start()


def main(arguments: Sequence[str]) -> int:
    """Fly the `FlightJob` in the argument (JSON); the last line on stdout is the cost.

    The end of stdin interrupts it, as Ctrl-C does.
    """
    try:
        with interruptible():
            _interrupt_with_parent()
            cost = fly(msgspec.json.decode(arguments[0], type=FlightJob))
    except (ScenarioError, SwarmError, psutil.NoSuchProcess) as error:
        sys.stderr.write(f"{error}\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return INTERRUPTED
    sys.stdout.write(msgspec.json.encode(cost).decode() + "\n")
    return FINE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Long flights: no process grows with simulated time."""

import os
import statistics
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

from msgspec import Struct

from harness.launch.process_commands import uav
from harness.launch.profiling import kind_of
from harness.launch.run_messages import SwarmError
from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from harness.simulator.messages import VehicleLost
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.soak.growth import slope
from studies.soak.measure import Measured, measure
from studies.soak.plan import SoakPlan

LAUNCHER = "launcher"
LEAST_S = 600.0
"""Length of a flight from which memory and processor time are judged: buffers fill for minutes"""
MOST_MB_PER_HOUR = 1.0
MOST_CPU_GROWTH = 0.05
"""Growth of the processor time of a simulated second, per hour, against its median"""
_ENDLESS_BATTERY = ("autopilot.params.BAT1_CAPACITY=100000",)
_GROUP = "flights"


class LongFlight(Struct, frozen=True, kw_only=True):
    """Measurements of one flight's processes, by name, at rising simulated times."""

    times_s: list[float]
    processes: dict[str, list[Measured]]


class Growth(Struct, frozen=True, kw_only=True):
    """Growth of one process per simulated hour; ``cpu`` relative to its median."""

    private_mb: float
    descriptors: float
    threads: float
    cpu: float


def jobs(plan: SoakPlan) -> dict[str, list[Job]]:
    """Return the long flights, each with a seed of its own."""
    seeds = range(1, plan.pieces + 1)
    return {_GROUP: [partial(fly, plan.agents, plan.piece_s, plan.sample_s, seed) for seed in seeds]}


def fly(agents: int, duration_s: float, sample_s: float, seed: int) -> LongFlight:
    """Fly the article's formation, and measure all processes each ``sample_s``. Raises SwarmError."""
    times_s: list[float] = []
    processes: dict[str, list[Measured]] = {}
    with Swarm(find("article"), agents=agents, seed=seed, overrides=_ENDLESS_BATTERY) as swarm:
        while swarm.truth.t_s < duration_s:
            swarm.run_for(sample_s)
            for event in swarm.events:
                if isinstance(event, VehicleLost):
                    lost = f"{uav(event.instance)} was lost at {event.time_us * 1e-6:.3f} s"
                    raise SwarmError(f"{lost} of seed {seed}: {event.reason}")
            times_s.append(swarm.truth.t_s)
            for name, pid in {LAUNCHER: os.getpid(), **swarm.pids}.items():
                processes.setdefault(name, []).append(measure(pid))
    return LongFlight(times_s=times_s, processes=processes)


def growth(flight: LongFlight, name: str) -> Growth:
    """Return the growth of a process in a flight."""
    hours = [time_s / 3_600.0 for time_s in flight.times_s]
    series = flight.processes[name]
    spent = [
        (after.cpu_s - before.cpu_s) / (end_h - begin_h)
        for (before, after), (begin_h, end_h) in zip(pairwise(series), pairwise(hours), strict=True)
    ]
    median = statistics.median(spent)
    return Growth(
        private_mb=slope(hours, [each.private_mb for each in series]),
        descriptors=slope(hours, [each.descriptors for each in series]),
        threads=slope(hours, [each.threads for each in series]),
        cpu=slope(hours[1:], spent) / median if median else 0.0,
    )


def judge(plan: SoakPlan, results: Results) -> Section:
    """Compare the growth of all processes with its limits."""
    flights: list[LongFlight] = results[_GROUP]
    names = list(flights[0].processes)
    grown = {name: [growth(flight, name) for flight in flights] for name in names}
    by_kind: dict[str, list[Growth]] = {}
    for name, each in grown.items():
        by_kind.setdefault(kind_of(name), []).append(_median(each))
    worst = {kind: _largest(each) for kind, each in by_kind.items()}
    is_long = plan.piece_s >= LEAST_S
    checks = [check for kind, each in worst.items() for check in _checks(kind, each, is_long=is_long)]
    simulated_h = sum(flight.times_s[-1] for flight in flights) / 3_600.0
    judged = "" if is_long else " Memory and processor time are not judged in flights this short."
    return Section(
        title="Long flights",
        conditions=filled(
            f"{len(flights)} flights of {plan.agents} UAVs in the article's formation, {simulated_h:.2f} "
            "simulated hours together, two at a time, with a battery that does not end. Growth is the median "
            "slope over all pairs of measurements after the first quarter of a flight, then the median over "
            f"the flights; of several processes of a kind the largest is shown.{judged}"
        )
        + "\n",
        checks=tuple(checks),
        tables=(_table(flights),),
    )


def _checks(kind: str, each: Growth, *, is_long: bool) -> Iterator[Check]:
    """Yield the checks of one kind of process, of memory and processor time only in long flights."""
    if is_long:
        yield Check(f"{kind}: private memory", each.private_mb, "MB per hour", at_most=MOST_MB_PER_HOUR)
    yield Check(f"{kind}: descriptors", each.descriptors, "per hour", at_most=0.0)
    yield Check(f"{kind}: threads", each.threads, "per hour", at_most=0.0)
    if is_long:
        name = f"{kind}: processor time of a simulated second"
        yield Check(name, 100.0 * each.cpu, "% per hour", at_most=100.0 * MOST_CPU_GROWTH)


def _median(each: list[Growth]) -> Growth:
    return Growth(
        **{name: statistics.median(getattr(one, name) for one in each) for name in Growth.__struct_fields__}
    )


def _largest(each: list[Growth]) -> Growth:
    return Growth(**{name: max(getattr(one, name) for one in each) for name in Growth.__struct_fields__})


def _table(flights: list[LongFlight]) -> ReportTable:
    """Return the first and last measurements of the first flight, by kind: the process with most memory."""
    kinds: dict[str, list[list[Measured]]] = {}
    for name, series in flights[0].processes.items():
        kinds.setdefault(kind_of(name), []).append(series)
    rows = []
    for kind, each in kinds.items():
        series = max(each, key=lambda one: one[-1].private_mb)
        first, last = series[0], series[-1]
        rows.append(
            (
                kind,
                f"{first.private_mb:.1f}",
                f"{last.private_mb:.1f}",
                f"{first.descriptors} / {last.descriptors}",
                f"{first.threads} / {last.threads}",
            )
        )
    return ReportTable(
        caption="First and last measurement of the first flight; of each kind the process with most memory.",
        columns=("process", "private MB, first", "private MB, last", "descriptors", "threads"),
        rows=tuple(rows),
    )

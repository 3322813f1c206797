"""Measure swarms with PX4s against PX4s with a bare simulator, in turns, and summarise by medians.

Every measurement runs in a separate process. "In flight" is in formation for swarms, and at a height in
offboard mode for PX4s with the bare simulator (`studies.bench.px4_bare`).
"""

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

from msgspec import Struct

from harness.launch import kernel_cache
from harness.launch.process_commands import PHYSICS, PREFORK, RADIO
from harness.launch.profiling import VEHICLES
from studies.bench.bench import SCENARIOS, HostMachine, measured, this_machine
from studies.bench.flight_job import LAUNCHER, FlightCost, FlightJob
from studies.bench.px4_job import BareCost, BareJob
from studies.bench.tables import Sheet

OWN, SEATS = "own vehicles", "PX4s in coflight"
BARE_FLIES, BARE_RESTS = "PX4s, bare simulator, in flight", "PX4s, bare simulator, at rest"
BARE_DEFAULT = "the same, default scheduling"
MEASUREMENTS = (OWN, SEATS, BARE_FLIES, BARE_RESTS, BARE_DEFAULT)
APPLICATIONS, SIMULATOR = "applications", PHYSICS
_COLUMNS = {
    VEHICLES: "vehicles", APPLICATIONS: "applications", SIMULATOR: "simulator", RADIO: "radio",
    LAUNCHER: "launcher",
}  # fmt: skip


class Px4Plan(Struct, frozen=True, kw_only=True):
    """Parameters of the comparison."""

    build: str
    """Folder of a PX4 SITL build."""
    user: str | None = None
    """User of the PX4s; None: this one, which must not be root."""
    settings: tuple[str, ...] = ()
    """Further settings of the scenario of all measurements with PX4s."""
    agents: int = 8
    duration_s: float = 20.0
    repeats: int = 3
    seed: int = 1

    def px4_settings(self) -> tuple[str, ...]:
        """Return the settings of the scenario for PX4s."""
        command: tuple[str, ...] = ()
        if self.user is not None:
            words = [
                "setpriv", f"--reuid={self.user}", f"--regid={self.user}", "--clear-groups",
                "--pdeathsig=keep",  # a PX4 ends with its wrapper, also if that is killed
                "{build}/bin/px4", "-i", "{i}", "-d", "{build}/etc", "-w", "{work}",
            ]  # fmt: skip
            command = (f"autopilot.px4_command={json.dumps(words)}",)
        kind = ("autopilot.kind=px4", f"autopilot.px4_build={Path(self.build).expanduser().absolute()}")
        return (*kind, *command, *self.settings)


class Px4Cost(Struct, frozen=True, kw_only=True):
    """One measurement."""

    real_time_factor: float
    """In flight; at rest for those at rest"""
    whole_real_time_factor: float | None
    """From the first step on, including take-off, of swarms"""
    cpu_s_per_simulated_s: dict[str, float]
    """By kind of process"""
    other_processors: float | None
    """Processors busy with other processes, of swarms"""


class Px4Bench(Struct, frozen=True, kw_only=True):
    """All measurements by name."""

    machine: HostMachine
    agents: int
    duration_s: float
    measurements: dict[str, list[Px4Cost]]


def compare(plan: Px4Plan, note: Callable[[str], None]) -> Px4Bench:
    """Measure in turns; ``note`` is called with progress. Raises BenchError and CompileError."""
    kernel_cache.prepare(note)
    machine = this_machine()
    found: dict[str, list[Px4Cost]] = {name: [] for name in MEASUREMENTS}
    for repeat in range(plan.repeats):
        for name in MEASUREMENTS:
            cost = _measure(plan, name)
            found[name].append(cost)
            note(f"{repeat + 1} of {plan.repeats}, {name}: {cost.real_time_factor:.2f} x real time")
    return Px4Bench(machine=machine, agents=plan.agents, duration_s=plan.duration_s, measurements=found)


def _measure(plan: Px4Plan, name: str) -> Px4Cost:
    with tempfile.TemporaryDirectory(prefix="coflight-bench-", ignore_cleanup_errors=True) as folder:
        before = os.umask(0o022 if plan.user is None else 0)
        try:
            if plan.user is not None:
                Path(folder).chmod(0o755)
            if name in (OWN, SEATS):
                return _fly(plan, f"{folder}/run", () if name == OWN else plan.px4_settings())
            run = Path(folder, "run")
            run.mkdir()
            return _fly_bare(plan, str(run), flies=name == BARE_FLIES, yields=name != BARE_DEFAULT)
        finally:
            os.umask(before)


def _fly(plan: Px4Plan, folder: str, settings: tuple[str, ...]) -> Px4Cost:
    job = FlightJob(
        scenario=str(SCENARIOS / "article.toml"), agents=plan.agents, seed=plan.seed,
        duration_s=plan.duration_s, folder=folder, wall_launched_s=time.monotonic(), settings=settings,
    )  # fmt: skip
    cost = measured("studies.bench.flight", job, FlightCost)
    return Px4Cost(
        real_time_factor=cost.steady.real_time_factor,
        whole_real_time_factor=cost.whole.real_time_factor,
        cpu_s_per_simulated_s={
            kind: spent for kind, spent in cost.steady.cpu_s_per_simulated_s.items() if kind != PREFORK
        },
        other_processors=cost.steady.other_processors,
    )


def _fly_bare(plan: Px4Plan, folder: str, *, flies: bool, yields: bool) -> Px4Cost:
    job = BareJob(
        scenario=str(SCENARIOS / "article.toml"), settings=plan.px4_settings(), agents=plan.agents,
        duration_s=plan.duration_s, folder=folder, flies=flies, yields=yields,
    )  # fmt: skip
    cost = measured("studies.bench.px4_bare", job, BareCost)
    return Px4Cost(
        real_time_factor=cost.real_time_factor,
        whole_real_time_factor=None,
        cpu_s_per_simulated_s={
            VEHICLES: cost.px4_cpu_s_per_simulated_s,
            SIMULATOR: cost.simulator_cpu_s_per_simulated_s,
        },
        other_processors=None,
    )


def sheet(found: Px4Bench) -> Sheet:
    """Return the table of medians: real-time factors, and processor time in ms per simulated second."""
    return Sheet(
        title=f"{found.agents} UAVs, {found.duration_s:g} s: simulated against wall time, and processor time "
        "in ms per simulated second",
        heading=("", "x real time", "slowest to fastest", "with take-off", *_COLUMNS.values(), "all"),
        rows=tuple(_rows(found)),
    )


def _rows(found: Px4Bench) -> Iterator[tuple[str, ...]]:
    for name, costs in found.measurements.items():
        factors = sorted(cost.real_time_factor for cost in costs)
        whole = [cost.whole_real_time_factor for cost in costs if cost.whole_real_time_factor is not None]
        spent_s = {
            kind: median(cost.cpu_s_per_simulated_s.get(kind, 0.0) for cost in costs) for kind in _COLUMNS
        }
        yield (
            name,
            f"{median(factors):.2f}",
            f"{factors[0]:.2f} to {factors[-1]:.2f}",
            f"{median(whole):.2f}" if whole else "-",
            *(f"{1e3 * spent:.0f}" if spent else "-" for spent in spent_s.values()),
            f"{1e3 * sum(spent_s.values()):.0f}",
        )
    seats = median(cost.real_time_factor for cost in found.measurements[SEATS])
    for name in (BARE_FLIES, BARE_RESTS, BARE_DEFAULT):
        share = seats / median(cost.real_time_factor for cost in found.measurements[name])
        yield (f"{SEATS}, of: {name}", f"{share:.0%}", *("" for _ in range(3 + len(_COLUMNS))))

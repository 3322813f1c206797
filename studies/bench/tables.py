"""Results of a benchmark as tables, for a terminal or as Markdown."""

from collections.abc import Iterator, Sequence

from msgspec import Struct
from rich.table import Table

from harness.launch.profiling import KINDS as KIND_NAMES
from studies.bench.bench import BenchRun, FlightBench
from studies.bench.flight_job import KINDS

LEAST_SHARE = 0.005
"""Share of the total time below which parts are combined in one row"""
INDENT = "  "
"""Prefix of the name of a part of the row above."""


class Sheet(Struct, frozen=True, kw_only=True):
    """One table: names in the first column, then a column for every number of UAVs."""

    title: str
    heading: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def sheets(found: FlightBench) -> tuple[Sheet, ...]:
    """Return the tables of speed, processor time by process and part, waiting, memory and start-up."""
    runs = found.runs
    heading = ("UAVs", *(str(run.agents) for run in runs))
    of = "one flight" if found.repeats == 1 else f"median of {found.repeats} flights"
    return (
        Sheet(
            title=f"Simulated against wall time: {found.duration_s:g} s in formation, {of}",
            heading=heading,
            rows=(
                ("in formation", *(_factor(run.real_time_factor) for run in runs)),
                ("slowest to fastest", *map(_spread, runs)),
                ("with take-off", *(_factor(run.whole_real_time_factor) for run in runs)),
                ("floor: bare processes", *(_factor(run.floor_real_time_factor) for run in runs)),
                ("floor: bytes alone", *(_factor(run.echo_real_time_factor) for run in runs)),
                ("processors busy with other processes", *(f"{run.other_processors:.1f}" for run in runs)),
            ),
        ),
        Sheet(
            title="Processor time in formation, ms per simulated second",
            heading=heading,
            rows=tuple(_processor_rows(runs)),
        ),
        Sheet(
            title="Share of wall time in which a process is idle / waits for a processor",
            heading=heading,
            rows=tuple((name, *(_idle(run, kind) for run in runs)) for kind, name in KIND_NAMES.items()),
        ),
        Sheet(
            title="Unshared memory of a process (USS), and start-up",
            heading=heading,
            rows=(
                *(
                    (f"{_name(kind)}, MB", *(f"{run.uss_mb.get(kind, 0.0):.0f}" for run in runs))
                    for kind in _kinds(runs)
                ),
                ("all, shared memory counted once (PSS), MB", *(f"{run.pss_mb:.0f}" for run in runs)),
                ("launch to first step, s", *(f"{run.startup_s:.1f}" for run in runs)),
            ),
        ),
    )


def _processor_rows(runs: Sequence[BenchRun]) -> Iterator[tuple[str, ...]]:
    for kind in _kinds(runs):
        yield (_name(kind), *(_ms(run.cpu_s_per_simulated_s.get(kind, 0.0)) for run in runs))
        listed, rest = _parts(runs, kind)
        spent = [run.parts_cpu_s_per_simulated_s.get(kind, {}) for run in runs]
        for parts in (*([part] for part in listed), *([rest] if rest else [])):
            sums = (sum(of_run.get(part, 0.0) for part in parts) for of_run in spent)
            yield (f"{INDENT}{', '.join(parts)}", *map(_ms, sums))
    yield ("all", *(_ms(_whole(run)) for run in runs))
    yield (
        "us of processor time per step and UAV",
        *(f"{4e3 * _whole(run) / run.agents:.0f}" for run in runs),
    )
    yield ("floor: bare processes", *(_ms(run.floor_cpu_s_per_simulated_s) for run in runs))


def _parts(runs: Sequence[BenchRun], kind: str) -> tuple[list[str], list[str]]:
    """Return the parts with a row, most expensive in the last run first, and the others."""
    most: dict[str, float] = {}
    for run in reversed(runs):
        for part, spent in run.parts_cpu_s_per_simulated_s.get(kind, {}).items():
            most[part] = max(most.get(part, 0.0), spent / _whole(run))
    listed = [part for part, share in most.items() if share >= LEAST_SHARE]
    return listed, [part for part, share in most.items() if share < LEAST_SHARE]


def _kinds(runs: Sequence[BenchRun]) -> list[str]:
    """Return the kinds of process of all runs in their order."""
    found = {kind for run in runs for kind in run.cpu_s_per_simulated_s}
    return [*(kind for kind in KINDS if kind in found), *sorted(found.difference(KINDS))]


def _name(kind: str) -> str:
    return KIND_NAMES.get(kind, kind)


def _whole(run: BenchRun) -> float:
    return sum(run.cpu_s_per_simulated_s.values())


def _idle(run: BenchRun, kind: str) -> str:
    if kind not in run.waiting_fraction:
        return "-"
    return f"{run.waiting_fraction[kind]:.0%} / {run.queueing_fraction[kind]:.0%}"


def _spread(run: BenchRun) -> str:
    factors = sorted(flight.steady.real_time_factor for flight in run.flights)
    return f"{_factor(factors[0])} to {_factor(factors[-1])}"


def _factor(value: float) -> str:
    return f"{value:.2f}" if value < 9.995 else f"{value:.1f}"


def _ms(value_s: float) -> str:
    return f"{1e3 * value_s:.0f}" if value_s >= 0.00995 else f"{1e3 * value_s:.1f}"


def terminal_table(sheet: Sheet) -> Table:
    """Return a table for a terminal, without its title, which may be longer than the rows."""
    table = Table()
    for number, name in enumerate(sheet.heading):
        table.add_column(name, justify="right" if number else "left")
    for name, *cells in sheet.rows:
        table.add_row(name, *cells, style=None if name.startswith(INDENT) else "bold")
    return table


def markdown(found: FlightBench) -> str:
    """Return all tables as Markdown."""
    machine = found.machine
    hardware = f"{machine.model}, {machine.processors} processors, {machine.memory_gb:g} GB"
    software = f"{machine.system}, Python {machine.python}"
    lines = [f"{hardware}; {software}; load {machine.load:g} before the start.", ""]
    for sheet in sheets(found):
        lines += [f"**{sheet.title}**", "", _cells(sheet.heading)]
        lines.append(_cells(("---", *("---:" for _ in sheet.heading[1:]))))
        lines += [_cells((name.replace(INDENT, "&nbsp;&nbsp;", 1), *cells)) for name, *cells in sheet.rows]
        lines.append("")
    return "\n".join(lines)


def _cells(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"

"""The tables of the chaos study."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from studies.chaos.faults import KINDS, PHASES, TARGETS, Fault
from studies.chaos.records import FlightRecord, first_and_again
from studies.chaos.requirements import END_LIMIT_S

NAME = "chaos.md"
TWO = "two faults"
_PAGE = """# Faults of processes

Real flights of two UAVs, each with a random fault of one process in one phase: imports, start, flight,
pause, stop, report. The launcher's imports begin when it handles signals: before, they end the interpreter as
any program. Each fifth flight has a second fault, of another process up to 1 s after the first. `disk` is a
small one that is filled. `application 0` and `px4 0` are processes of flights with stand-ins for PX4.

A flight has to end within {limit:g} s of its last fault, or to go on as documented, with the
documented exit status; its messages have to name the process with its id, or as lost, and the signal that has
killed it; after 2 s no process and no temporary file may be left, except the folder of the radio's socket
of a launcher that was killed; its records have to be readable. Of two faults the messages may name either.

Drawn with seed {seed}: `coflight study chaos --flights {flights} --seed {seed} --out docs/results`;
{at_a_time}of commit {commits}.

{flown} flights, {bad} not as required{repeated}. {unreached} more ended before their fault{left_out}.
{second_unreached} of {two} second faults found their process ended; these flights are judged by the first.

## By process and fault

| process | fault | flights | as required | on repetition | phases | statuses | longest until the end |
|---|---|---|---|---|---|---|---|
{rows}

## By phase

| phase | flights | as required | on repetition | statuses | longest until the end |
|---|---|---|---|---|---|
{phases}
{complaints}"""


def page(
    flights_flown: Sequence[FlightRecord], *, flights: int, seed: int, beside: int | None, left_out: int = 0
) -> str:
    """Return the page.

    ``beside`` is the largest number of flights at the same time, None if they were flown in several sessions.
    """
    first, again = first_and_again(flights_flown)
    flown = [first[number] for number in sorted(first) if not _is_before_fault(first[number])]
    bad = [each for each in flown if each.outcome.complaints]
    two = [each for each in flown if each.outcome.fault.second is not None]
    repeated = [again[each.number] for each in bad if each.number in again]
    commits = dict.fromkeys(each.commit for each in flights_flown)
    return _PAGE.format(
        limit=END_LIMIT_S,
        seed=seed,
        flights=flights,
        at_a_time="" if beside is None else _at_a_time(beside),
        commits=", ".join(f"`{_short(commit)}`" if commit else "unknown" for commit in commits) or "unknown",
        flown=len(flown),
        bad=len(bad),
        repeated=f", of which {sum(map(_is_fine, repeated))} were on repetition" if repeated else "",
        unreached=len(first) - len(flown),
        left_out=f", and {left_out} with a full disk were left out" if left_out else "",
        two=len(two),
        second_unreached=sum(not each.outcome.second_reached for each in two),
        rows="\n".join(_rows(flown, again)),
        phases="\n".join(_phase_rows(flown, again)),
        complaints=_complaints(bad, again),
    )


def _short(commit: str) -> str:
    name, dash, state = commit.partition("-")
    return name[:10] + dash + state


def _at_a_time(beside: int) -> str:
    return f"up to {beside} at a time on {len(os.sched_getaffinity(0))} processors, "


def _is_before_fault(flown: FlightRecord) -> bool:
    """Whether a flight has ended before its fault, and as it may."""
    return not flown.outcome.reached and not flown.outcome.complaints


def _is_fine(flown: FlightRecord) -> bool:
    return flown.outcome.reached and not flown.outcome.complaints


def _rows(flown: Sequence[FlightRecord], again: dict[int, FlightRecord]) -> list[str]:
    rows = []

    def add(name: str, kind: str, holds: Callable[[Fault], bool]) -> None:
        some = [each for each in flown if holds(each.outcome.fault)]
        if some:
            found = {each.outcome.fault.phase for each in some}
            phases = ", ".join(phase for phase in PHASES if phase in found)
            fine, repeated, statuses, longest = _counts(some, again)
            rows.append(_row(name, kind, len(some), fine, repeated, phases, statuses, longest))

    for target in TARGETS:
        for kind in KINDS:
            add(target, kind, lambda fault: (fault.target, fault.kind, fault.second) == (target, kind, None))  # noqa: B023
    for target in TARGETS:
        add(target, TWO, lambda fault: fault.target == target and fault.second is not None)  # noqa: B023
    return rows


def _phase_rows(flown: Sequence[FlightRecord], again: dict[int, FlightRecord]) -> list[str]:
    rows = []
    for phase in PHASES:
        some = [each for each in flown if each.outcome.fault.phase == phase]
        if some:
            fine, repeated, statuses, longest = _counts(some, again)
            rows.append(_row(phase, len(some), fine, repeated, statuses, longest))
    return rows


def _counts(some: Sequence[FlightRecord], again: dict[int, FlightRecord]) -> tuple[int, str, str, str]:
    """Return how many are as required and how many of the repeated, the statuses and the longest time."""
    repeated = [again[each.number] for each in some if each.outcome.complaints and each.number in again]
    statuses = ", ".join(sorted({str(each.outcome.status) for each in some}))
    longest_s = max(each.outcome.ended_s for each in some)
    on_repetition = f"{sum(map(_is_fine, repeated))} of {len(repeated)}" if repeated else ""
    return sum(map(_is_fine, some)), on_repetition, statuses, f"{longest_s:.1f} s"


def _row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _complaints(bad: Sequence[FlightRecord], again: dict[int, FlightRecord]) -> str:
    if not bad:
        return ""
    lines = []
    for each in bad:
        line = f"- {each.number}: {each.outcome.fault.line}: {'; '.join(each.outcome.complaints)}"
        if each.number in again:
            repeated = again[each.number]
            judgement = "; ".join(repeated.outcome.complaints) or "as required"
            judgement = "ended before its fault" if _is_before_fault(repeated) else judgement
            line += f". On repetition: {judgement}"
        lines.append(line)
    return "\n## Not as required\n\nThe number is the place in the plan.\n\n" + "\n".join(lines) + "\n"


def write(folder: Path, text: str) -> Path:
    """Write the page into a folder; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    path.write_text(text, encoding="utf-8")
    return path

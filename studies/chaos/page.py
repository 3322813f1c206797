"""The table of the chaos study."""

from collections.abc import Sequence
from pathlib import Path

from studies.chaos.faults import KINDS, TARGETS
from studies.chaos.flight import END_LIMIT_S, Outcome

NAME = "chaos.md"
_PAGE = """# Faults of processes

Real flights of two UAVs, each with one random fault of one process in one phase: imports, start, flight,
pause, stop, report. The launcher's imports begin when it handles signals: before, they end the interpreter as
any program. A flight has to end within {limit:g} s of the fault, or to go on as documented, with the
documented exit status; its messages have to name the process with its id, or as lost, and the signal that has
killed it; after 2 s no process and no temporary file may be left, except the folder of the radio's socket
of a launcher that was killed; its records have to be readable. Drawn with seed {seed}:
`coflight study chaos --flights {flights} --seed {seed} --out docs/results`.

{flown} flights, {bad} not as required. {unreached} more ended before their fault.

| process | fault | flights | as required | phases | statuses | longest until the end |
|---|---|---|---|---|---|---|
{rows}
{complaints}"""


def page(outcomes: Sequence[Outcome], *, flights: int, seed: int) -> str:
    """Return the page."""
    flown = [outcome for outcome in outcomes if outcome.reached]
    bad = [outcome for outcome in flown if outcome.complaints]
    listed = "\n".join(
        f"- {each.fault.title} after {each.fault.delay_s:g} s: {'; '.join(each.complaints)}" for each in bad
    )
    return _PAGE.format(
        limit=END_LIMIT_S,
        seed=seed,
        flights=flights,
        flown=len(flown),
        bad=len(bad),
        unreached=len(outcomes) - len(flown),
        rows="\n".join(_rows(flown)),
        complaints=f"\n## Not as required\n\n{listed}\n" if bad else "",
    )


def _rows(flown: Sequence[Outcome]) -> list[str]:
    rows = []
    for target in TARGETS:
        for kind in KINDS:
            some = [each for each in flown if (each.fault.target, each.fault.kind) == (target, kind)]
            if not some:
                continue
            phases = ", ".join(dict.fromkeys(each.fault.phase for each in some))
            statuses = ", ".join(sorted({str(each.status) for each in some}))
            fine = sum(not each.complaints for each in some)
            longest_s = max(each.ended_s for each in some)
            cells = (target, kind, len(some), fine, phases, statuses, f"{longest_s:.1f} s")
            rows.append(f"| {' | '.join(map(str, cells))} |")
    return rows


def write(folder: Path, text: str) -> Path:
    """Write the page into a folder; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    path.write_text(text, encoding="utf-8")
    return path

"""Introduction of the results page: command, number of flights and state of the sources."""

from collections import Counter
from collections.abc import Iterable, Sequence

from harness.campaign.definition import Run
from studies.codesign.book import Book
from studies.codesign.cases import ARTICLE, QUICK, CodesignPlan
from studies.common.command_line import repeated_command
from studies.common.report import flights_introduction

_MEANING = (
    "The quantities are described in [ranging and localisation](../concepts/ranging-and-localisation.md). "
    "Intervals have 95 % confidence: Student's interval for means over the flights, "
    "a bootstrap over pairs of flights for ratios."
)


def command(plan: CodesignPlan, only: Sequence[str] = (), *, quick: bool = False, stale: bool = False) -> str:
    """Return the command that generates the page, without folders; ``only`` is empty for all groups."""
    usual = QUICK if quick else CodesignPlan()
    return repeated_command(
        "experiment_codesign.py", ("--quick", quick), (f"--only {','.join(only)}", bool(only)),
        (f"--seeds {plan.seeds}", plan.seeds != usual.seeds),
        (f"--duration {plan.duration_s:g}", plan.duration_s != usual.duration_s), ("--stale", stale),
    )  # fmt: skip


def introduction(book: Book, runs: Sequence[Run], *, made_by: str, changed: bool = False) -> str:
    """Return the introduction of the page, with the flights that its numbers are based on.

    Args:
        book: the flights.
        runs: the flights that the page requires, with the current sources.
        made_by: the command, without its output folder.
        changed: whether the sources changed during the run.

    """
    if runs:
        sentences = [_flown(book, runs), _sources(book, runs)]
    else:
        sentences = ["from simulated measurements, without a flight. The same sources give the same numbers."]
    if changed:
        sentences.append("The sources changed during the run: its flights cannot be assigned to one state.")
    broken = [f"{flown.case}, seed {flown.seed}: {flown.broken}" for flown in book.broken()]
    return flights_introduction(made_by, " ".join([*sentences, _MEANING]), broken)


def _flown(book: Book, runs: Sequence[Run]) -> str:
    """Return the sentence with the number of flights and cases that have results, and their duration."""
    required = {(run.case, run.seed): run for run in runs}
    flown = {key: each.measures for key, each in book.flights.items() if key in required and each.measures}
    per_case = Counter(case for case, _ in flown)
    without = len({case for case, _ in required}) - len(per_case)
    if not flown:
        return f"without a flight of any of the {without} cases."
    simulated_min, wall_min = (
        sum(getattr(each, name) for each in flown.values()) / 60.0 for name in ("simulated_s", "wall_s")
    )
    durations_s = [required[key].scenario.run.duration_s for key in flown]
    return (
        f"from {len(flown)} flights of `scenarios/{ARTICLE.name}` and its variants, "
        f"{_range(durations_s)} s in formation each as planned: {_range(per_case.values())} of each of "
        f"{len(per_case)} cases{f', and none of {without} more' if without else ''}. "
        f"{simulated_min:.0f} minutes were simulated in {wall_min:.0f} minutes of wall time."
    )


def _sources(book: Book, runs: Sequence[Run]) -> str:
    """Return the sentence on reproducibility: whether all flights are of the current sources."""
    required = {(run.case, run.seed): run.digest for run in runs}
    flown = {key: each for key, each in book.flights.items() if key in required}
    stale = sum(each.digest != required[key] for key, each in flown.items())
    if stale:
        states = len({each.state for each in flown.values()})
        return (
            f"**{stale} of the flights are of other states of the sources than the current one**, {states} "
            f"state{'s' if states > 1 else ''} in total: no single state reproduces all these numbers, and "
            "only the two flights of a pair have the same state."
        )
    return (
        "Flights with the same seed have the same winds and the same GPS receiver errors in every case. All "
        "numbers except the wall time are determined by the seeds: the same sources give the same numbers."
    )


def _range(values: Iterable[float]) -> str:
    """Format the range of values as ``6 to 10``, or as a single value."""
    all_values = list(values)
    low, high = min(all_values), max(all_values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"

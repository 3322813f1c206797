"""Judgement of losses, a cut of the channel and a lying vehicle."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from harness.records.flight import Array
from studies.codesign import figures
from studies.codesign.book import Book
from studies.codesign.cases import (
    BASE,
    DROPPED,
    LIAR,
    LIAR_FROM_START,
    LIE_M,
    LOSSY,
    CodesignCase,
    CodesignPlan,
    cut,
    liar_in_flight,
)
from studies.codesign.checks import formed_check, pairs_check, sound_checks
from studies.codesign.measures import TRACK_PERIOD_S
from studies.codesign.statistics import mean_interval
from studies.codesign.trouble import (
    PULL_WINDOW_S,
    RECOVERED_FACTOR,
    RECOVERED_M,
    SETTLED_S,
    SMOOTHED_S,
    CutResult,
    Pull,
    judge_cut,
    judge_liar,
    shape_over_time_m,
)
from studies.common.report import Check, ReportTable, Section

GROWTH_MOST = 1.5
RECOVERY_MOST_S = 10.0
PULL_MOST_M = 0.3
CUT_SEEN, LIE_SEEN = 0.9, 0.95
"""Shares of the cut and of the lie that the flight itself must show: else there was nothing to withstand."""
LOSS_SEEN, COMPLETED_MOST = 0.28, 0.75
"""Share of beacons that the losses must take, and of ranging sessions that they may leave, likewise"""


def judge_trouble(book: Book, images: Path | None) -> Section:
    """Check what the issue asks for when the radio fails or a vehicle lies."""
    plan, cut_case = book.plan, cut(book.plan)
    shapes_m = _shapes_over_time(book, cut_case)
    cuts = [judge_cut(shape_m, cut_at_s=plan.cut_s, cut_s=plan.cut_s) for shape_m in shapes_m]
    pulls = {
        "in flight": _pulls(book, liar_in_flight(plan), plan.liar_after_s),
        "from the start": _pulls(book, LIAR_FROM_START, 0.0),
    }
    cases = (BASE, LOSSY, cut_case, liar_in_flight(plan), LIAR_FROM_START)
    growth = book.ratio(LOSSY, BASE, "shape_m")
    if images is not None:
        length = min((len(shape_m) for shape_m in shapes_m), default=0)
        together_m = np.empty((len(shapes_m), length))
        for row, shape_m in zip(together_m, shapes_m, strict=True):
            row[:] = shape_m[:length]
        figures.save_cut(
            images / "codesign-cut.png",
            np.asarray(TRACK_PERIOD_S * np.arange(length), dtype=np.float64),
            together_m,
            cut_at_s=plan.cut_s,
            cut_s=plan.cut_s,
            usual_m=float(np.mean([each.before_m for each in cuts])) if cuts else math.nan,
        )
    return Section(
        title="Losses, a cut channel, a liar",
        conditions=_conditions(plan),
        checks=(
            formed_check(book, cases),
            *sound_checks(book, cases),
            pairs_check("with and without losses", growth.count),
            *(pairs_check(f"with and without a liar {since}", len(of)) for since, of in pulls.items()),
            Check(
                name="losses: share of the beacons that hosts lost", unit="", at_least=LOSS_SEEN,
                value=book.mean(LOSSY, "beacons_lost_fraction").value,
            ),
            Check(
                name="losses: share of ranging sessions that complete", unit="", at_most=COMPLETED_MOST,
                value=book.mean(LOSSY, "completed_fraction").value,
            ),
            Check(
                name=f"{DROPPED:.0%} of beacons and distances lost: growth of the shape error",
                value=growth.value, unit="", at_most=GROWTH_MOST,
            ),
            Check(
                name="cut: time without any distance, shortest", unit="s", at_least=CUT_SEEN * plan.cut_s,
                value=min(_known(book.values(cut_case, "longest_silence_s")), default=math.nan),
            ),
            Check(
                name="cut: flights with a collision",
                value=float(book.collided(cut_case)) if book.flown(cut_case) else math.nan, unit="",
                at_most=0.0,
            ),
            Check(
                name="cut: recovery from the channel's return, slowest",
                value=max((each.recovery_s for each in cuts), default=math.nan), unit="s",
                at_most=RECOVERY_MOST_S,
            ),
            Check(
                name="liar: error of the distances that it measures, median, smallest", unit="m",
                value=min(_lies_m(book, plan), default=math.nan), at_least=LIE_SEEN * LIE_M,
            ),
            Check(
                name=f"liar in flight: displacement of another within the shape over {PULL_WINDOW_S:g} s, "
                "largest",
                value=_worst(pulls["in flight"], "displacement_m"), unit="m", at_most=PULL_MOST_M,
            ),
            Check(
                name=f"liar in flight: displacement of another in space over {PULL_WINDOW_S:g} s, largest",
                value=_worst(pulls["in flight"], "moved_m"), unit="m", at_most=PULL_MOST_M,
            ),
            Check(
                name="liar from the start: lasting displacement of another within the shape, largest",
                value=_worst(pulls["from the start"], "lasting_m"), unit="m", at_most=PULL_MOST_M,
            ),
        ),
        tables=(
            ReportTable(
                caption="Shape error with losses, m: means and 95 % confidence intervals; growth by pairs.",
                columns=(
                    "lost", "shape m", "estimates m", "completed %", "beacons lost %", "growth", "collided",
                ),
                rows=tuple(
                    (
                        f"{case.drop_fraction:.0%}", book.mean(case, "shape_m").text(),
                        book.mean(case, "estimate_m").text(),
                        book.mean(case, "completed_fraction").text(1, factor=100.0),
                        book.mean(case, "beacons_lost_fraction").text(1, factor=100.0),
                        growth.text(2) if case is LOSSY else "1", book.of_flights(book.collided(case), case),
                    )
                    for case in (BASE, LOSSY)
                ),
            ),
            _cut_table(book, cut_case, cuts),
            _liar_table(pulls),
        ),
        figures=()
        if images is None
        else (("codesign-cut.png", "shape error over time through a cut of the channel"),),
    )  # fmt: skip


def _conditions(plan: CodesignPlan) -> str:
    return f"""8 UAVs with FTM in 5 N.

Losses: {DROPPED:.0%} of the received beacons and of the ranging results, on top of the channel's.

Cut: no frame gets through from {plan.cut_s:.3g} s after the formation was reached, for {plan.cut_s:.3g} s.
The formation is back when its horizontal shape error, rms over UAVs and {SMOOTHED_S:g} s, is below
{RECOVERED_FACTOR:g} times the rms from before the cut or {RECOVERED_M:g} m, whichever is more, and stays
there for {SETTLED_S:g} s.

Liar: all distances that UAV {LIAR} measures are {LIE_M:g} m too long, from {plan.liar_after_s:.3g} s after
the formation was reached or from the start on. The other seven are compared with the same seed's flight
without lies, in space, and within their shape: there each flight's seven are laid over their places first,
which takes out how far they were shifted and turned as a whole. What they are displaced by is averaged over
{PULL_WINDOW_S:g} s, or over all the time (lasting). Until it begins to lie in flight both flights are the
same, so displacement is all its doing; with lies from the start the two form at different times, in other
gusts, and the lasting displacement within the shape alone tells.
"""


def _shapes_over_time(book: Book, case: CodesignCase) -> list[Array]:
    """(T,) of every flight that formed."""
    places_ned_m = case.scenario(book.plan, 1).places_ned_m()
    return [
        shape_over_time_m(flight.track_ne_m, places_ned_m) for flight in book.flown(case) if flight.track_mm
    ]


def _pulls(book: Book, case: CodesignCase, from_s: float) -> list[Pull]:
    """Of the seeds that have both flights."""
    places_ned_m = case.scenario(book.plan, 1).places_ned_m()
    return [
        judge_liar(lying.track_ne_m, usual.track_ne_m, places_ned_m, liar=LIAR, from_s=from_s)
        for lying, usual in book.pairs(case, BASE)
        if lying.track_mm and usual.track_mm
    ]


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _lies_m(book: Book, plan: CodesignPlan) -> list[float]:
    flights = [*book.flown(liar_in_flight(plan)), *book.flown(LIAR_FROM_START)]
    return _known([flight.range_offsets_m[LIAR] for flight in flights if flight.range_offsets_m])


def _worst(pulls: Sequence[Pull], what: str) -> float:
    """Largest; NaN if it is not known of one of them, or there are none."""
    return float(np.max([getattr(pull, what) for pull in pulls])) if pulls else math.nan


def _cut_table(book: Book, case: CodesignCase, cuts: Sequence[CutResult]) -> ReportTable:
    def cell(what: str) -> str:
        values = [getattr(each, what) for each in cuts]
        return mean_interval([value if math.isfinite(value) else None for value in values]).text()

    def largest(what: str) -> str:
        return f"{max((getattr(each, what) for each in cuts), default=math.nan):.2f}"

    recovered = sum(math.isfinite(each.recovery_s) for each in cuts)
    return ReportTable(
        caption="The cut: shape error, m, and seconds from the channel's return to the recovery, which is 0 "
        "for a flight that was within the bounds by then; the largest error, rms over "
        f"{SMOOTHED_S:g} s, of the worst flight; and flights that left the bounds at all.",
        columns=(
            "before", "during", "after the recovery", "recovery s", "recovered", "largest during",
            "largest after", "left the bounds", "collided", "nearest m",
        ),
        rows=((
            cell("before_m"), cell("during_m"), cell("after_m"), cell("recovery_s"),
            f"{recovered} of {len(cuts)}", largest("largest_during_m"), largest("largest_after_m"),
            f"{sum(each.left for each in cuts)} of {len(cuts)}", book.of_flights(book.collided(case), case),
            book.least(case, "least_distance_formed_m"),
        ),),
    )  # fmt: skip


def _liar_table(pulls: dict[str, list[Pull]]) -> ReportTable:
    rows = []
    for since, of_seeds in pulls.items():
        values = {
            what: [
                None if math.isnan(value) else value for value in (getattr(each, what) for each in of_seeds)
            ]
            for what in Pull.__struct_fields__
        }
        rows.append((
            since, mean_interval(values["shape_without_m"]).text(), mean_interval(values["shape_m"]).text(),
            *(
                f"{mean_interval(values[what]).text(2)}; {_worst(of_seeds, what):.2f}"
                for what in ("displacement_m", "lasting_m", "moved_m", "shift_m", "turn_deg")
            ),
        ))  # fmt: skip
    return ReportTable(
        caption="The liar: the other seven's shape error, the largest displacement of one of them, and how "
        "far they were shifted and turned as a whole, m and degrees; of displacements, shift and turn the "
        "mean of the flights and the worst flight.",
        columns=(
            "lies",
            "shape without",
            "shape with",
            "displaced within the shape",
            "lasting",
            "displaced in space",
            "their centre shifted",
            "turned °",
        ),
        rows=tuple(rows),
    )

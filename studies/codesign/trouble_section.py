"""Judgement of message losses, a channel outage and a vehicle with biased ranging."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from foundation.types import Array
from harness.campaign.intervals import mean_interval
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
from studies.common.report import Check, ReportFigure, ReportTable, Section

MEANS = ("shape m", "estimates m", "completed %", "beacons lost %")
GROWTH_MOST = 1.5
RECOVERY_MOST_S = 10.0
PULL_MOST_M = 0.3
CUT_SEEN, LIE_SEEN = 0.9, 0.95
"""Shares of outage and bias that must be measured in the flight; otherwise the fault was not effective."""
LOSS_SEEN, COMPLETED_MOST = 0.28, 0.75
"""Smallest share of lost beacons, and largest share of completed ranging sessions, likewise"""


def judge_trouble(book: Book) -> Section:
    """Check the requirements for a failing radio and for biased ranging."""
    plan, cut_case = book.plan, cut(book.plan)
    shapes_m = _shapes_over_time(book, cut_case)
    cuts = [judge_cut(shape_m, cut_at_s=plan.cut_s, cut_s=plan.cut_s) for shape_m in shapes_m]
    pulls = {
        "in flight": _pulls(book, liar_in_flight(plan), plan.liar_after_s),
        "from the start": _pulls(book, LIAR_FROM_START, 0.0),
    }
    cases = (BASE, LOSSY, cut_case, liar_in_flight(plan), LIAR_FROM_START)
    growth = book.ratio(LOSSY, BASE, "shape_m")
    length = min((len(shape_m) for shape_m in shapes_m), default=0)
    draw = partial(
        figures.save_cut, time_s=TRACK_PERIOD_S * np.arange(float(length)),
        shape_m=np.array([shape_m[:length] for shape_m in shapes_m]), cut_at_s=plan.cut_s, cut_s=plan.cut_s,
        usual_m=float(np.mean([each.before_m for each in cuts])) if cuts else math.nan,
    )  # fmt: skip
    return Section(
        title="Losses, a channel outage, biased ranging",
        conditions=_conditions(plan),
        checks=(
            formed_check(book, cases),
            *sound_checks(book, cases),
            pairs_check("with and without losses", growth.count),
            *(pairs_check(f"with and without ranging bias {since}", len(of)) for since, of in pulls.items()),
            Check(
                "losses: share of the beacons lost at the hosts",
                book.mean(LOSSY, "beacons_lost_fraction").value, at_least=LOSS_SEEN,
            ),
            Check(
                "losses: share of ranging sessions that complete",
                book.mean(LOSSY, "completed_fraction").value, at_most=COMPLETED_MOST,
            ),
            Check(
                f"{DROPPED:.0%} of beacons and distances lost: growth of the shape error", growth.value,
                at_most=GROWTH_MOST,
            ),
            Check(
                "outage: time without any distance, shortest",
                min(_known(book.values(cut_case, "longest_silence_s")), default=math.nan), "s",
                at_least=CUT_SEEN * plan.cut_s,
            ),
            Check(
                "outage: flights with a collision",
                float(book.collided(cut_case)) if book.flown(cut_case) else math.nan, at_most=0.0,
            ),
            Check(
                "outage: recovery after the channel's return, slowest",
                max((each.recovery_s for each in cuts), default=math.nan), "s", at_most=RECOVERY_MOST_S,
            ),
            Check(
                "ranging bias: error of the measured distances, median, smallest",
                min(_lies_m(book, plan), default=math.nan), "m", at_least=LIE_SEEN * LIE_M,
            ),
            Check(
                "ranging bias in flight: displacement of another in the shape over "
                f"{PULL_WINDOW_S:g} s, largest",
                _worst(pulls["in flight"], "displacement_m"), "m", at_most=PULL_MOST_M,
            ),
            Check(
                f"ranging bias in flight: displacement of another in space over {PULL_WINDOW_S:g} s, "
                "largest",
                _worst(pulls["in flight"], "moved_m"), "m", at_most=PULL_MOST_M,
            ),
            Check(
                "ranging bias from the start: lasting displacement of another in the shape, largest",
                _worst(pulls["from the start"], "lasting_m"), "m", at_most=PULL_MOST_M,
            ),
        ),
        tables=(
            ReportTable(
                caption="Shape error with losses, m: means and 95 % confidence intervals; growth by pairs.",
                columns=("lost", *MEANS, "growth", "collided"),
                rows=tuple(
                    (
                        f"{case.drop_fraction:.0%}", *(book.cell(case, column) for column in MEANS),
                        growth.text(2) if case is LOSSY else "1", book.of_flights(book.collided, case),
                    )
                    for case in (BASE, LOSSY)
                ),
            ),
            _cut_table(book, cut_case, cuts),
            _liar_table(pulls),
        ),
        figures=(
            ReportFigure("codesign-cut.png", "shape error over time through a channel outage", draw),
        ),
    )  # fmt: skip


def _conditions(plan: CodesignPlan) -> str:
    return f"""8 UAVs with FTM in 5 N.

Losses: {DROPPED:.0%} of the received beacons and of the ranging results, in addition to the channel's losses.

Outage: no frame is received from {plan.cut_s:.3g} s after the formation is reached, for {plan.cut_s:.3g} s.
The formation has recovered when its horizontal shape error, rms over UAVs and {SMOOTHED_S:g} s, is below
{RECOVERED_FACTOR:g} times the rms before the outage or {RECOVERED_M:g} m, whichever is larger, and stays
there for {SETTLED_S:g} s.

Ranging bias: all distances measured by UAV {LIAR} are {LIE_M:g} m too long, from {plan.liar_after_s:.3g} s
after the formation is reached, or from the start. The other seven UAVs are compared with the flight of the
same seed without bias: in space, and in their shape after the best alignment with the desired places, which
removes the common translation and rotation. Displacements are averaged over {PULL_WINDOW_S:g} s, or over the
whole time (lasting). With a bias in flight both flights are identical until it begins, so the displacement is
entirely due to it. With a bias from the start the two formations are reached at different times and in
different gusts, so only the lasting displacement in the shape is meaningful.
"""


def _shapes_over_time(book: Book, case: CodesignCase) -> list[Array]:
    """Return the shape error (T,) of every flight that formed."""
    places_ned_m = case.scenario(book.plan, 1).places_ned_m()
    return [
        shape_over_time_m(flight.track_ne_m, places_ned_m) for flight in book.flown(case) if flight.track_mm
    ]


def _pulls(book: Book, case: CodesignCase, from_s: float) -> list[Pull]:
    """Return the displacements for the seeds that have both flights."""
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
    """Return the largest value; NaN if one is missing or there are none."""
    return float(np.max([getattr(pull, what) for pull in pulls])) if pulls else math.nan


def _cut_table(book: Book, case: CodesignCase, cuts: Sequence[CutResult]) -> ReportTable:
    def cell(what: str) -> str:
        values = [getattr(each, what) for each in cuts]
        return mean_interval([value if math.isfinite(value) else None for value in values]).text()

    def largest(what: str) -> str:
        return f"{max((getattr(each, what) for each in cuts), default=math.nan):.2f}"

    recovered = sum(math.isfinite(each.recovery_s) for each in cuts)
    return ReportTable(
        caption="Outage: shape error, m, and seconds from the channel's return to the recovery, which is 0 "
        "for a flight that is within the bounds at the return; the largest error, rms over "
        f"{SMOOTHED_S:g} s, of the worst flight; and the flights that left the bounds.",
        columns=(
            "before", "during", "after the recovery", "recovery s", "recovered", "largest during",
            "largest after", "left the bounds", "collided", "nearest m",
        ),
        rows=((
            cell("before_m"), cell("during_m"), cell("after_m"), cell("recovery_s"),
            f"{recovered} of {len(cuts)}", largest("largest_during_m"), largest("largest_after_m"),
            f"{sum(each.left for each in cuts)} of {len(cuts)}", book.of_flights(book.collided, case),
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
        caption="Ranging bias: shape error of the other seven UAVs, the largest displacement of one of them, "
        "and their common translation and rotation, m and degrees; displacements, translation and rotation "
        "as mean of the flights and worst flight.",
        columns=(
            "bias", "shape without", "shape with", "displaced in the shape", "lasting", "displaced in space",
            "centre shifted", "turned °",
        ),
        rows=tuple(rows),
    )  # fmt: skip

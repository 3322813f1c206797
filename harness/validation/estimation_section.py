"""The estimator against its requirements; the arithmetic is `harness.validation.estimation`'s."""

import math
from pathlib import Path

import numpy as np

from harness.validation.estimation import (
    MEASUREMENTS,
    SETTLED_S,
    Consistency,
    WrongCompass,
    consistency,
    outage_drift_m,
    whiteness,
    wrong_compass,
)
from harness.validation.figures import save_nees
from harness.validation.plan import Job, Plan, Results
from harness.validation.report import Check, Section, Table

REQUIRED = ("position", "velocity")
DRIFT_LIMIT_M = 5.0
CAUGHT_LIMIT_S = 10.0
HEADING_LIMIT_DEG = 10.0


def jobs(plan: Plan) -> dict[str, list[Job]]:
    """Consistency is one job, for its runs are drawn together."""
    return {
        "consistency": [(_consistency, plan.estimator_runs)],
        "outage": [(outage_drift_m, seed) for seed in range(plan.seeds)],
        "compass": [(_turned_compass, seed) for seed in range(max(plan.seeds // 2, 1))],
    }


def _consistency(runs: int) -> Consistency:
    return consistency(runs=runs)


def _turned_compass(seed: int) -> WrongCompass:
    return wrong_compass(seed, math.pi)


def judge(plan: Plan, results: Results, images: Path | None) -> Section:
    """Check consistency, whiteness, outage and a compass that is turned round."""
    found: Consistency = results["consistency"][0]
    drifts_m: list[float] = results["outage"]
    compasses: list[WrongCompass] = results["compass"]
    low, high = found.band()
    checks = [
        Check(
            name=f"{group}: NEES per degree of freedom",
            value=float(found.mean(group).mean()),
            unit="",
            at_least=low,
            at_most=high,
        )
        for group in REQUIRED
    ]
    rows = []
    for name in MEASUREMENTS:
        white = whiteness(found.innovations[name])
        checks.append(
            Check(
                name=f"innovations of {name}: greatest autocorrelation",
                value=white.greatest,
                unit="",
                at_most=white.greatest_limit,
            )
        )
        rows.append((
            name, f"{white.inside:.3f} ({white.band[0]:.3f} to {white.band[1]:.3f})",
            f"{white.mean_square:.3f} ({white.mean_square_band[0]:.3f} to {white.mean_square_band[1]:.3f})",
        ))  # fmt: skip
    caught_s = [math.inf if case.caught_s is None else case.caught_s for case in compasses]
    checks += [
        Check(
            name="drift in 10 s without GPS, calm hover, worst", value=max(drifts_m), unit="m",
            at_most=DRIFT_LIMIT_M,
        ),
        Check(
            name="compass turned by 180°: caught after motion begins, slowest", value=max(caught_s), unit="s",
            at_most=CAUGHT_LIMIT_S,
        ),
        Check(
            name="compass turned by 180°: heading at the end, worst rms",
            value=math.degrees(max(case.heading_error_rad for case in compasses)), unit="deg",
            at_most=HEADING_LIMIT_DEG,
        ),
    ]  # fmt: skip
    figures: tuple[tuple[str, str], ...] = ()
    if images is not None:
        save_nees(
            images / "validation-nees.png",
            time_s=found.time_s,
            means={group: found.mean(group) for group in found.nees},
            band=(low, high),
        )
        figures = (("validation-nees.png", "normalised estimation errors over time, mean of the runs"),)
    return Section(
        title="Estimator",
        conditions=(
            f"Consistency is asked of data that obey the filter's model: {plan.estimator_runs} Monte Carlo "
            "runs of a figure of eight with white sensor noises of the size that the filter is told and "
            f"biases that walk as it believes, from {SETTLED_S:g} s on. The normalised estimation error "
            "squared (NEES) is the mean over runs and epochs; required is the two-sided 95 % chi-squared "
            "band of one epoch's mean over the runs, which is wider than that of many epochs. Innovations "
            "are white if the greatest of their mean autocorrelations at 20 lags stays below its limit at "
            f"95 % for all lags together. {len(drifts_m)} outages; {len(compasses)} flights in which the "
            "compass is turned by 180 degrees from the start on.\n"
        ),
        checks=tuple(checks),
        tables=(
            Table(
                caption="Share of epochs in which the mean over the runs is inside its band:",
                columns=tuple(found.nees),
                rows=(tuple(f"{found.inside(group):.2f}" for group in found.nees),),
            ),
            Table(
                caption="Innovations (in brackets the 95 % band of a white one):",
                columns=("measurement", "autocorrelations within ±1.96/√n", "mean square"),
                rows=tuple(rows),
            ),
            Table(
                caption="Distribution:",
                columns=("what", "median", "greatest"),
                rows=tuple(
                    (name, *(f"{value:.3g}" for value in np.quantile(values, (0.5, 1.0))))
                    for name, values in (("drift, m", drifts_m), ("compass caught after, s", caught_s))
                ),
            ),
        ),
        figures=figures,
    )

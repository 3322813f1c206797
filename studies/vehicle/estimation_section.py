"""The estimator against its requirements; the computation is in `studies.vehicle.estimation`."""

import math
from functools import partial
from itertools import product

import numpy as np

from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.vehicle import estimation
from studies.vehicle.figures import save_nees
from studies.vehicle.plan import VehiclePlan

REQUIRED = ("position", "velocity")
CAMPAIGN_SEEDS = (1, 2, 3)
DRIFT_LIMIT_M = 5.0
CAUGHT_LIMIT_S = 10.0
HEADING_LIMIT_DEG = 10.0


def jobs(plan: VehiclePlan) -> dict[str, list[Job]]:
    """Return the jobs; consistency has one job for each seed, because its runs share the draws."""
    return {
        "consistency": [
            partial(estimation.consistency, runs=plan.estimator_runs, seed=seed) for seed in CAMPAIGN_SEEDS
        ],
        "outage": [partial(estimation.outage_drift_m, seed) for seed in range(plan.seeds)],
        "compass": [
            partial(estimation.wrong_compass, seed, math.pi) for seed in range(max(plan.seeds // 2, 1))
        ],
    }


def judge(plan: VehiclePlan, results: Results) -> Section:
    """Check consistency, whiteness, drift in an outage and a compass turned by 180 degrees."""
    campaigns: list[estimation.Consistency] = results["consistency"]
    by_seed = list(zip(CAMPAIGN_SEEDS, campaigns, strict=True))
    found = estimation.pooled(campaigns)
    drifts_m: list[float] = results["outage"]
    compasses: list[estimation.WrongCompass] = results["compass"]
    checks = []
    labelled = [*((f"seed {seed}", one) for seed, one in by_seed), ("all seeds", found)]
    for group, (label, one) in product(REQUIRED, labelled):
        mean, (low, high) = one.overall(group)
        checks.append(
            Check(f"{group}: NEES per degree of freedom, {label}", mean, at_least=low, at_most=high)
        )
    rows = []
    for name in estimation.MEASUREMENTS:
        white = estimation.whiteness(found.innovations[name])
        checks.append(
            Check(
                f"innovations of {name}: greatest autocorrelation",
                white.greatest,
                at_most=white.greatest_limit,
            )
        )
        rows.append((
            name, f"{white.inside:.3f} ({white.band[0]:.3f} to {white.band[1]:.3f})",
            f"{white.mean_square:.3f} ({white.mean_square_band[0]:.3f} to {white.mean_square_band[1]:.3f})",
        ))  # fmt: skip
    caught_s = [math.inf if case.caught_s is None else case.caught_s for case in compasses]
    checks += [
        Check("drift in 10 s without GPS, calm hover, worst", max(drifts_m), "m", at_most=DRIFT_LIMIT_M),
        Check(
            "compass turned by 180°: detected after motion begins, slowest", max(caught_s), "s",
            at_most=CAUGHT_LIMIT_S,
        ),
        Check(
            "compass turned by 180°: heading at the end, worst rms",
            math.degrees(max(case.heading_error_rad for case in compasses)), "deg", at_most=HEADING_LIMIT_DEG,
        ),
    ]  # fmt: skip
    means = {group: found.mean(group) for group in found.nees}
    draw = partial(save_nees, time_s=found.time_s, means=means, band=found.band())
    return Section(
        title="Estimator",
        conditions=(
            "Consistency is tested with data that match the filter's model: for each of the seeds "
            f"{', '.join(map(str, CAMPAIGN_SEEDS))} a campaign of {plan.estimator_runs} Monte Carlo runs of "
            "a figure of eight, with white sensor noises and bias random walks of the configured size, "
            f"evaluated from {estimation.SETTLED_S:g} s on. The normalised estimation error squared (NEES) "
            "is the mean over all runs and epochs of a campaign and must be inside the two-sided 95 % "
            "chi-squared band of that mean. The epochs of a run are correlated, so the band uses the "
            "effective number of epochs that follows from their autocorrelation. Each seed must be inside, "
            "and so must all runs together; a consistent filter misses one of these bands in about one of "
            "four draws of the seeds. The innovations of all seeds are white if the greatest of their mean "
            "autocorrelations at 20 lags is below the 95 % limit for all lags together. Further tests: "
            f"{len(drifts_m)} GPS outages, and {len(compasses)} flights with a compass that is turned by 180 "
            "degrees from the start.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="NEES per degree of freedom of all groups (in brackets its 95 % band), by seed:",
                columns=("seed", *found.nees),
                rows=tuple(
                    (str(seed), *(_nees_cell(one, group) for group in one.nees)) for seed, one in by_seed
                ),
            ),
            ReportTable(
                caption=(
                    "Share of epochs in which the mean over a campaign's runs is inside the 95 % band of one "
                    "epoch:"
                ),
                columns=("seed", *found.nees),
                rows=tuple(
                    (str(seed), *(f"{one.inside(group):.2f}" for group in one.nees)) for seed, one in by_seed
                ),
            ),
            ReportTable(
                caption="Innovations (in brackets the 95 % band of white noise):",
                columns=("measurement", "autocorrelations within ±1.96/√n", "mean square"),
                rows=tuple(rows),
            ),
            ReportTable(
                caption="Distribution:",
                columns=("what", "median", "greatest"),
                rows=tuple(
                    (name, *(f"{value:.3g}" for value in np.quantile(values, (0.5, 1.0))))
                    for name, values in (
                        ("drift, m", drifts_m), ("compass error detected after, s", caught_s),
                    )
                ),
            ),
        ),
        figures=(
            ReportFigure(
                "validation-nees.png", "normalised estimation errors over time, mean of the runs", draw
            ),
        ),
    )  # fmt: skip


def _nees_cell(found: estimation.Consistency, group: str) -> str:
    mean, (low, high) = found.overall(group)
    outside = "" if low <= mean <= high else ", outside"
    return f"{mean:.3f} ({low:.3f} to {high:.3f}){outside}"

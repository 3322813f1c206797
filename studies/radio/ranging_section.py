"""Fine Time Measurement of one pair compared with its reference figures."""

import math
from functools import partial

import numpy as np

from netsim.lab.ranging import FtmResultSummary, range_pair
from netsim.model.config import BandwidthMhz, Mode
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_ranging
from studies.radio.plan import RadioPlan
from studies.radio.statistics import mean_of

BIAS_M = 0.7
BIAS_LIMIT_M = 0.01
BIAS_SESSIONS = 2_000
"""Sessions in each mean that is compared with the limit; its standard error is 3 mm at 20 MHz."""
WIDTHS: tuple[BandwidthMhz, ...] = (20, 40, 80)
ROUND_TRIP_M: dict[BandwidthMhz, float] = {20: 0.384, 40: 0.161}
"""Measured over cable (Zubow et al., WONS 2022): 2563 and 1075 ps, times c/2."""
SIGMA_TOLERANCE = 0.10
FRAMES = 8
FRAMES_PER_BURST = (2, 3, 5, 8, 16, 31)
AIRTIMES_MS: tuple[tuple[BandwidthMhz, Mode, float], ...] = (
    (20, "ofdm6", 1.75),
    (20, "ofdm24", 1.18),
    (80, "vht_mcs0", 1.50),
)
"""Air time of a session of eight measurement frames at AC_VO, computed from the standard's timing."""
AIRTIME_TOLERANCE = 0.05


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Return the jobs: every width with every seed, every burst length, every air time."""
    pair = partial(range_pair, distance_m=30.0, bias_m=BIAS_M)
    groups: dict[str, list[Job]] = {
        f"width/{width}": [
            partial(pair, width_mhz=width, sessions=BIAS_SESSIONS, ftms_per_burst=FRAMES, seed=seed)
            for seed in range(1, plan.seeds + 1)
        ]
        for width in WIDTHS
    }
    for width in (20, 80):
        groups[f"frames/{width}"] = [
            partial(pair, width_mhz=width, sessions=plan.sessions, ftms_per_burst=frames, seed=100)
            for frames in FRAMES_PER_BURST
        ]
    groups["airtime"] = [
        partial(pair, width_mhz=width, sessions=100, ftms_per_burst=FRAMES, mode=mode, seed=1)
        for width, mode, _ in AIRTIMES_MS
    ]
    return groups


def judge(plan: RadioPlan, results: Results) -> Section:
    """Check bias, sigma, averaging and air time."""
    checks, rows = [], []
    for width in WIDTHS:
        runs: list[FtmResultSummary] = results[f"width/{width}"]
        errors_m = [_known(run.error_mean_m) - BIAS_M for run in runs]
        trip = mean_of([run.round_trip_std_m for run in runs])
        checks.append(
            Check(
                f"{width} MHz: mean error less bias, worst of {len(runs)} x {BIAS_SESSIONS} sessions",
                1e2 * max(map(abs, errors_m)), "cm", at_most=1e2 * BIAS_LIMIT_M,
            )
        )  # fmt: skip
        if width in ROUND_TRIP_M:
            name = f"{width} MHz: sigma of a round trip"
            checks.append(Check.near(name, trip.value, ROUND_TRIP_M[width], SIGMA_TOLERANCE, "m"))
        rows.append((
            str(width), mean_of([1e2 * error_m for error_m in errors_m]).text(2), trip.text(4),
            mean_of([run.error_std_m for run in runs]).text(4), str(sum(run.failed for run in runs)),
        ))  # fmt: skip
    spreads: dict[int, tuple[float, list[float]]] = {}
    for width in (20, 80):
        runs = results[f"frames/{width}"]
        # one round trip alone has no scatter
        scatters_m = [run.round_trip_std_m for run in runs if run.round_trip_std_m is not None]
        trip_m = float(np.sqrt(np.mean(np.square(scatters_m)))) if scatters_m else math.nan
        spreads[width] = (trip_m, [_known(run.error_std_m) for run in runs])
        for frames, run in zip(FRAMES_PER_BURST, runs, strict=True):
            name = f"{width} MHz, {frames} frames: error's sigma over round trip's / √{frames - 1}"
            ratio = _known(run.error_std_m) * math.sqrt(frames - 1) / trip_m
            checks.append(Check.near(name, ratio, 1.0, SIGMA_TOLERANCE))
    for (width, mode, airtime_ms), run in zip(AIRTIMES_MS, results["airtime"], strict=True):
        name = f"{width} MHz, {mode}: air time of a session"
        checks.append(Check.near(name, run.airtime_ms, airtime_ms, AIRTIME_TOLERANCE, "ms"))
    all_runs = [run for group in results.values() for run in group]
    checks.append(
        Check(
            f"sessions that failed, of {sum(run.failed + run.completed for run in all_runs)}",
            sum(run.failed for run in all_runs), at_most=0.0,
        )
    )  # fmt: skip
    draw = partial(save_ranging, frames=FRAMES_PER_BURST, spreads=spreads)
    return Section(
        title="Fine Time Measurement of one pair",
        conditions=(
            "Sessions in sequence over 30 m, without fading, with crystal errors of up to 20 ppm and "
            f"{BIAS_M:g} m of calibration offset, in the most robust format of the width. {FRAMES} "
            f"measurement frames result in {FRAMES - 1} round trips, whose scatter within a session is the "
            "sigma of a round trip. Their errors are white and average out, so the sigma of a session's "
            "error is the sigma of a round trip over the root of their number; this is checked with "
            f"{plan.sessions} sessions for each number of frames. The air time is the sum of a session's "
            "frames, SIFS, and AIFS with mean backoff of each exchange; it is compared with the standard's "
            "timing.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption=f"Mean of {plan.seeds} seeds ± standard error, {BIAS_SESSIONS} sessions each:",
                columns=(
                    "MHz", "error less bias, cm", "sigma of a round trip, m", "of a session, m", "failed",
                ),
                rows=tuple(rows),
            ),
        ),
        figures=(ReportFigure("radio-ftm.png", "ranging error over the frames of a burst", draw),),
    )  # fmt: skip


def _known(value: float | None) -> float:
    """Return the value, or NaN, which fails every check, if there were too few sessions for one."""
    return math.nan if value is None else value

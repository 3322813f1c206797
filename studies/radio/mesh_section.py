"""Fine Time Measurement between all pairs compared with the air time that it needs."""

from functools import partial

import numpy as np

from netsim.lab.ranging import MeshResult, range_mesh
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_mesh
from studies.radio.plan import RadioPlan
from studies.radio.statistics import Mesh, mean_of

PERIODS_S = (0.1, 0.05)
FRAMES = 8
FITS, FULL = 0.6, 1.2
"""Requested shares of the air time: up to `FITS` nearly all sessions must complete, from `FULL` on the
channel is full."""
COMPLETED = 0.98
LOST, SHARED = 0.25, 0.15
"""Shares of a full channel's capacity: loss by collisions and aborted sessions, gain by stations that wait at
the same time."""
DELAYED = 3.0


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Return the jobs of every number of stations with every seed, the longest runs first."""
    return {
        _key(period_s, stations): [
            partial(
                range_mesh, stations=stations, period_s=period_s, seconds=plan.mesh_s, ftms_per_burst=FRAMES,
                seed=seed,
            )
            for seed in range(1, plan.seeds + 1)
        ]
        for stations in range(plan.mesh_stations, 1, -1)
        for period_s in PERIODS_S
    }  # fmt: skip


def judge(plan: RadioPlan, results: Results) -> Section:
    """Check the completed round trips against the available air time."""
    counts = range(2, plan.mesh_stations + 1)
    periods = {period_s: [_means(results[_key(period_s, n)]) for n in counts] for period_s in PERIODS_S}
    checks = [check for period_s, row in periods.items() for check in _checks(period_s, row)]
    shows = "completion, occupancy and delay of ranging between all pairs"
    return Section(
        title="Fine Time Measurement of all pairs",
        conditions=(
            "n stations on a circle of 30 m range to each other station once in a period: 80 MHz, VHT MCS 0, "
            f"AC_VO, {FRAMES} frames in a burst. The requests of a station are spread evenly over the period "
            "from an individual phase on, with a time-out of one period. The requested air time is that of a "
            "single session times the number of requested sessions. Completed are the sessions that return a "
            f"distance; a burst that exceeds its time ends with fewer than {FRAMES - 1} round trips, so the "
            "channel's throughput is the share of the requested round trips. If less than "
            f"{100 * FITS:.0f} % of the time is requested, nearly all sessions must complete. If more than "
            f"{100 * FULL:.0f} % is requested, the channel is full: the share of round trips must be the one "
            f"that fits, 1 over the requested air time, less at most {100 * LOST:.0f} % for collisions and "
            f"aborted sessions, plus at most {100 * SHARED:.0f} % for stations that wait at the same time; "
            f"and a session takes at least {DELAYED:g} times as long as between two stations only. Mean of "
            f"{plan.seeds} runs of {plan.mesh_s:g} s.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="By number of stations (delay ± standard error):",
                columns=(
                    "period, s", "n", "sessions/s", "air requested", "completed", "round trips", "delay, ms",
                    "busy",
                ),
                rows=tuple(_cells(period_s, mesh) for period_s, row in periods.items() for mesh in row),
            ),
        ),
        figures=(ReportFigure("radio-ftm-mesh.png", shows, partial(save_mesh, periods=periods)),),
    )  # fmt: skip


def _checks(period_s: float, row: list[Mesh]) -> list[Check]:
    """Return the checks of one period; the first entry of the row has two stations."""
    checks = []
    for mesh in row:
        name = f"n = {mesh.stations} every {period_s:g} s"
        if mesh.requested <= FITS:
            checks.append(Check(f"{name}: completed", mesh.completed.value, at_least=COMPLETED))
        elif mesh.requested >= FULL:
            checks += [
                Check(
                    f"{name}: share of the requested round trips", mesh.round_trips.value,
                    at_least=(1.0 - LOST) / mesh.requested, at_most=(1.0 + SHARED) / mesh.requested,
                ),
                Check(
                    f"{name}: delay over that of two stations", mesh.delay_ms.value / row[0].delay_ms.value,
                    at_least=DELAYED,
                ),
            ]  # fmt: skip
    return checks


def _cells(period_s: float, mesh: Mesh) -> tuple[str, ...]:
    sessions_s = mesh.stations * (mesh.stations - 1) / period_s
    shares = (mesh.completed.value, mesh.round_trips.value)
    return (
        f"{period_s:g}", str(mesh.stations), f"{sessions_s:.0f}", f"{100 * mesh.requested:.0f} %",
        *(f"{100 * share:.1f} %" for share in shares), mesh.delay_ms.text(2),
        f"{100 * mesh.busy.value:.0f} %",
    )  # fmt: skip


def _key(period_s: float, stations: int) -> str:
    return f"{period_s:g}/{stations}"


def _means(runs: list[MeshResult]) -> Mesh:
    return Mesh(
        stations=runs[0].stations,
        requested=float(np.mean([run.airtime_fraction for run in runs])),
        completed=mean_of([run.completed_fraction for run in runs]),
        round_trips=mean_of([run.completed_fraction * run.round_trips_mean / (FRAMES - 1) for run in runs]),
        delay_ms=mean_of([run.mean_delay_ms for run in runs]),
        busy=mean_of([run.busy_fraction for run in runs]),
    )

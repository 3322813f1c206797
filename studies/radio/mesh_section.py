"""Fine Time Measurement between all pairs against the air time that it needs."""

from pathlib import Path

import numpy as np
from msgspec import Struct

from netsim.lab.ranging import MeshResult, range_mesh
from studies.common.report import Check, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_mesh
from studies.radio.plan import RadioPlan
from studies.radio.statistics import Mesh, mean_of

PERIODS_S = (0.1, 0.05)
FRAMES = 8
FITS, FULL = 0.6, 1.2
"""Share of the time that the sessions want: below the first nearly all must come about, above the second they
cannot."""
COMPLETED = 0.98
LOST, SHARED = 0.25, 0.15
"""Of a full channel's capacity: what collisions and sessions that fail half-way may take, and what stations
that wait at the same time may save."""
DELAYED = 3.0


class _Run(Struct, frozen=True, kw_only=True):
    stations: int
    period_s: float
    seconds: float
    seed: int


def _range_mesh(run: _Run) -> MeshResult:
    return range_mesh(
        stations=run.stations,
        period_s=run.period_s,
        seconds=run.seconds,
        ftms_per_burst=FRAMES,
        seed=run.seed,
    )


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Every number of stations with every seed, the longest runs first."""
    return {
        _key(period_s, stations): [
            (_range_mesh, _Run(stations=stations, period_s=period_s, seconds=plan.mesh_s, seed=seed))
            for seed in range(1, plan.seeds + 1)
        ]
        for stations in range(plan.mesh_stations, 1, -1)
        for period_s in PERIODS_S
    }


def judge(plan: RadioPlan, results: Results, images: Path | None) -> Section:
    """Check that round trips come about as far as the sessions' air time lets them."""
    counts = range(2, plan.mesh_stations + 1)
    periods = {period_s: [_means(results[_key(period_s, n)]) for n in counts] for period_s in PERIODS_S}
    checks = [check for period_s, row in periods.items() for check in _checks(period_s, row)]
    figures: tuple[tuple[str, str], ...] = ()
    if images is not None:
        save_mesh(images / "radio-ftm-mesh.png", periods)
        figures = (("radio-ftm-mesh.png", "completion, occupancy and delay of ranging between all pairs"),)
    return Section(
        title="Fine Time Measurement of all pairs",
        conditions=(
            "n stations on a circle of 30 m range to every other one once in a period, 80 MHz, VHT MCS 0, "
            f"AC_VO, {FRAMES} frames in a burst, requests spread evenly over the period from a phase of each "
            "station's own on, with a time-out of one period. Wanted is the air time of one session alone "
            "times the sessions asked for. Completed are the sessions that gave a distance; a burst that "
            f"does not get through in its time ends with fewer than {FRAMES - 1} round trips, so what the "
            "channel carried are the round trips, of those asked for. Where less than "
            f"{100 * FITS:.0f} % of the time is wanted nearly all sessions must complete. Where more than "
            f"{100 * FULL:.0f} % is wanted the channel is full: of the round trips there must be the share "
            f"that fits, one over what is wanted, less at most {100 * LOST:.0f} % for collisions and for "
            f"sessions that fail half-way, and at most {100 * SHARED:.0f} % more, for stations that wait at "
            f"the same time; and a session takes at least {DELAYED:g} times as long as between two stations "
            f"alone. Mean of {plan.seeds} runs of {plan.mesh_s:g} s.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="By number of stations (delay ± standard error):",
                columns=(
                    "period, s", "n", "sessions/s", "air wanted", "completed", "round trips", "delay, ms",
                    "busy",
                ),
                rows=tuple(_cells(period_s, mesh) for period_s, row in periods.items() for mesh in row),
            ),
        ),
        figures=figures,
    )  # fmt: skip


def _checks(period_s: float, row: list[Mesh]) -> list[Check]:
    """Requirements of one period; the first of the row are two stations."""
    checks = []
    for mesh in row:
        name = f"n = {mesh.stations} every {period_s:g} s"
        if mesh.wanted <= FITS:
            checks.append(
                Check(name=f"{name}: completed", value=mesh.completed.value, unit="", at_least=COMPLETED)
            )
        elif mesh.wanted >= FULL:
            checks += [
                Check(
                    name=f"{name}: round trips of those asked for", value=mesh.round_trips.value, unit="",
                    at_least=(1.0 - LOST) / mesh.wanted, at_most=(1.0 + SHARED) / mesh.wanted,
                ),
                Check(
                    name=f"{name}: delay over that of two stations",
                    value=mesh.delay_ms.value / row[0].delay_ms.value, unit="", at_least=DELAYED,
                ),
            ]  # fmt: skip
    return checks


def _cells(period_s: float, mesh: Mesh) -> tuple[str, ...]:
    sessions_s = mesh.stations * (mesh.stations - 1) / period_s
    shares = (mesh.completed.value, mesh.round_trips.value)
    return (
        f"{period_s:g}", str(mesh.stations), f"{sessions_s:.0f}", f"{100 * mesh.wanted:.0f} %",
        *(f"{100 * share:.1f} %" for share in shares), mesh.delay_ms.text(2),
        f"{100 * mesh.busy.value:.0f} %",
    )  # fmt: skip


def _key(period_s: float, stations: int) -> str:
    return f"{period_s:g}/{stations}"


def _means(runs: list[MeshResult]) -> Mesh:
    return Mesh(
        stations=runs[0].stations,
        wanted=float(np.mean([run.airtime_fraction for run in runs])),
        completed=mean_of([run.completed_fraction for run in runs]),
        round_trips=mean_of([run.completed_fraction * run.round_trips_mean / (FRAMES - 1) for run in runs]),
        delay_ms=mean_of([run.mean_delay_ms for run in runs]),
        busy=mean_of([run.busy_fraction for run in runs]),
    )

"""Periodic broadcasts compared with ns-3."""

import math
from functools import partial

from netsim.lab.broadcast import broadcast
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_broadcast
from studies.radio.peers import Broadcasts, ns3_broadcasts, ns3_phase_draws
from studies.radio.plan import RadioPlan
from studies.radio.statistics import Mean, difference_error, mean_of

RATIO_TOLERANCE = 0.03
DELAY_TOLERANCE = 0.10
LONG_PERIOD_S = 0.1
CAPACITY_HZ = 2_000.0
"""Approximate capacity for frames of 0.5 ms; above it the initial phases soon have no influence."""
SURE = 2.0
"""Standard errors of a difference of two means that are added to its tolerance."""
SAME_INSTANT_S = 2.0
"""Length of runs without jitter, in which every tick is the same."""
LEAST_RATIO = 0.05
"""Below this delivery ratio the delay is not compared."""


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Return the jobs of every row, as many ticks as in ns-3's run, the longest runs first."""
    rows = sorted(_rows(plan), key=lambda row: -row.stations * row.stations / row.period_s)
    return {
        _key(row): [
            partial(
                broadcast, stations=row.stations, payload_bytes=row.payload_bytes, period_s=row.period_s,
                jitter_s=row.jitter_s, seconds=SAME_INSTANT_S if row.jitter_s == 0.0 else row.seconds,
                seed=seed,
            )
            for seed in range(1, _seeds(plan, row) + 1)
        ]
        for row in rows
    }  # fmt: skip


def judge(plan: RadioPlan, results: Results) -> Section:
    """Compare delivery ratio and mean delay of every row."""
    checks, cells = [], []
    rows = _rows(plan)
    ratios = {key: mean_of([run.delivery_ratio for run in group]) for key, group in results.items()}
    delays_ms = {key: mean_of([run.mean_delay_ms for run in group]) for key, group in results.items()}
    for row in rows:
        key, name = _key(row), _name(row)
        reference, reference_ms = theirs(row)
        spare = SURE * difference_error(ratios[key], reference) if _is_drawn(row) else 0.0
        spare_ms = SURE * difference_error(delays_ms[key], reference_ms) if _is_drawn(row) else 0.0
        checks.append(
            Check(
                f"{name}: delivered", ratios[key].value,
                at_least=max(reference.value - RATIO_TOLERANCE - spare, 0.0),
                at_most=min(reference.value + RATIO_TOLERANCE + spare, 1.0),
            )
        )  # fmt: skip
        if reference.value > LEAST_RATIO:
            checks.append(
                Check(
                    f"{name}: mean delay", delays_ms[key].value, "ms",
                    at_least=(1.0 - DELAY_TOLERANCE) * reference_ms.value - spare_ms,
                    at_most=(1.0 + DELAY_TOLERANCE) * reference_ms.value + spare_ms,
                )
            )  # fmt: skip
        p95_ms = mean_of([run.p95_ms for run in results[key]])
        delay = f"{delays_ms[key].text(3)} ({reference_ms.text(3)})" if row.mean_delay_ms else ""
        cells.append((
            name, str(len(results[key])), f"{ratios[key].text(4)} ({reference.text(4)})",
            delay, f"{p95_ms.value:.2f}" if row.mean_delay_ms else "",
        ))  # fmt: skip
    shown = [(row, (ratios[_key(row)], delays_ms[_key(row)]), theirs(row)) for row in rows]
    draw = partial(save_broadcast, rows=shown, long_s=LONG_PERIOD_S)
    return Section(
        title="Periodic broadcasts",
        conditions=(
            "All stations have synchronous ticks. At each tick each station broadcasts one datagram of 300 "
            "B of UDP, after a new uniform jitter below the given bound, or at a phase that is drawn once: "
            "802.11a at 6 Mbit/s, DCF, no acknowledgements, no retransmissions, all stations in range, no "
            "channel errors. A row of ns-3 is one run of ns-3 3.37; ours have as many ticks (60 s at 0.1 "
            "s, or 20 s) and are the mean of several runs. With phases drawn once and periods below 100 "
            "ms, single runs differ by more than the tolerance, in ns-3 as well: there our mean is "
            f"compared with the mean of several ns-3 seeds, and {SURE:g} standard errors of the difference "
            "are added to the tolerance. Delivered is the share of the possible receptions; the delay is "
            "from the application's call to the end of the frame. The delivery ratio must agree within "
            f"{RATIO_TOLERANCE:g}, and where it is above {LEAST_RATIO:g}, the mean delay within "
            f"{100 * DELAY_TOLERANCE:.0f} %. With jitter 0 all stations send at the same instant on an idle "
            "medium, so all frames collide.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="Ours ± standard error (ns-3):",
                columns=("stations, period, jitter", "runs", "delivered", "mean delay, ms", "95 %, ms"),
                rows=tuple(cells),
            ),
        ),
        figures=(
            ReportFigure("radio-broadcast.png", "delivery and delay of broadcasts, compared with ns-3", draw),
        ),
    )


def theirs(row: Broadcasts) -> tuple[Mean, Mean]:
    """Return ns-3's delivery ratio and mean delay in ms: those of the row, or the mean over its seeds."""
    draws = ns3_phase_draws().get((row.stations, row.period_s)) if _is_drawn(row) else None
    ratios, delays_ms = zip(*(draws or [(row.delivery_ratio, row.mean_delay_ms)]), strict=True)
    return mean_of(ratios), mean_of(delays_ms)


def _rows(plan: RadioPlan) -> list[Broadcasts]:
    return [row for row in ns3_broadcasts() if row.stations <= plan.stations]


def _seeds(plan: RadioPlan, row: Broadcasts) -> int:
    """Return the number of runs, larger for runs with fewer datagrams."""
    if row.jitter_s == 0.0:
        return 1  # deterministic
    if _is_drawn(row) and row.stations / row.period_s < CAPACITY_HZ:
        return plan.phase_seeds
    in_one = row.stations * row.seconds / row.period_s
    return min(max(math.ceil(plan.datagrams / in_one), 1), 4 * plan.seeds)


def _is_drawn(row: Broadcasts) -> bool:
    """Whether the result depends on the phases that were drawn."""
    return row.jitter_s < 0.0 and row.period_s < LONG_PERIOD_S


def _key(row: Broadcasts) -> str:
    return f"{row.stations}/{row.period_s:g}/{row.jitter_s:g}"


def _name(row: Broadcasts) -> str:
    jitter = "phases drawn once" if row.jitter_s < 0.0 else f"jitter {1e3 * row.jitter_s:g} ms"
    return f"n = {row.stations}, {1e3 * row.period_s:g} ms, {jitter}"

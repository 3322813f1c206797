"""Judgement of the beacon, ranging and baseline cases: checks, tables and figures."""

import math
from functools import partial

import numpy as np

from studies.codesign import checks, figures
from studies.codesign.book import Book
from studies.codesign.cases import (
    BASE,
    BEACON_PERIODS_MS,
    FTM_PERIODS_S,
    GPS_ALONE,
    IDEAL,
    TRUTH,
    all_pairs,
    beacon_period,
    scheduled,
)
from studies.common.report import Check, ReportFigure, Section

OFTEN_MS, SELDOM_MS = 50, 200
"""Beacon periods between which no difference is claimed."""
COMPLETED_LEAST = 0.95
"""Smallest share of completed ranging sessions where contention is claimed not to be the limit"""
SHARE_MOST = 1.1
"""Largest ratio of the channel occupancy to the configured share of scheduled ranging"""
THRIFT_MOST = 0.5
"""Largest air time of scheduled ranging with 16 UAVs over that of all pairs once a second"""
WASTE_LEAST, WASTED_LEAST = 5.0, 0.5
"""All pairs ten times as often: smallest ratios of air time and of shape error. Independent errors would be
reduced to 1 / sqrt(10) = 0.32, so most of the air time has no effect."""
CONTROLS_LEAST = math.sqrt(0.5)
"""Shape error with true positions over that with FTM: control causes at least half of the mean square."""


def judge_beacon_period(book: Book) -> Section:
    """Compare beacon periods."""
    cases = [beacon_period(period_ms) for period_ms in BEACON_PERIODS_MS]
    sooner = book.ratio(beacon_period(SELDOM_MS), beacon_period(OFTEN_MS), "shape_m")
    later = book.ratio(cases[-1], BASE, "estimate_m")
    parts = {
        "shape error": "shape_m", "error of the estimates": "estimate_m", "control's part": "control_m"
    }  # fmt: skip
    parts_m = {label: [book.mean(case, what) for case in cases] for label, what in parts.items()}
    draw = partial(figures.save_beacons, periods_ms=BEACON_PERIODS_MS, parts_m=parts_m)
    return Section(
        title="Beacon period",
        conditions="8 UAVs with FTM in 5 N; each UAV ranges to all others once per second in all cases.\n",
        checks=(
            checks.formed_check(book, cases),
            *checks.sound_checks(book, cases),
            checks.fewest_pairs_check((sooner, later)),
            checks.largest_shape_check(book, cases, "any period"),
            Check(
                f"shape error at {SELDOM_MS} ms over that at {OFTEN_MS} ms", sooner.value,
                at_most=checks.NO_WORSE_MOST,
            ),
            Check(
                f"error of the estimates at {BEACON_PERIODS_MS[-1]} ms over that at "
                f"{BASE.beacon_period_ms} ms, lower end",
                later.low, at_least=1.0,
            ),
        ),
        tables=(
            book.means_table(
                ("period ms",), ("shape m", "estimates m", "control m", "busy %"),
                zip(map(str, BEACON_PERIODS_MS), cases, strict=True),
            ),
        ),
        figures=(ReportFigure("codesign-beacons.png", "shape error against the beacon period", draw),),
    )  # fmt: skip


def judge_ranging(book: Book) -> Section:
    """Compare ranging policies: shape error against air time."""
    policies = {
        agents: [
            *((f"all pairs, {period_s:g} s", all_pairs(agents, period_s)) for period_s in periods_s),
            ("scheduled", scheduled(agents)),
        ]
        for agents, periods_s in FTM_PERIODS_S.items()
    }
    points = {
        f"{agents} UAVs": [
            (name, book.mean(case, "busy_fraction"), book.mean(case, "shape_m")) for name, case in entries
        ]
        for agents, entries in policies.items()
    }
    draw = partial(figures.save_ranging, points=points)
    return Section(
        title="Ranging policy",
        conditions=(
            "FTM in 5 N. All pairs: each UAV ranges to every other one once per period, as in the article. "
            "Scheduled: one end of each pair ranges, in a dedicated slot, when the distance is worth its air "
            "time. All pairs of 16 UAVs every 0.25 s exceed the capacity of the channel: this policy is in "
            "the table but not in the checks.\n"
        ),
        checks=_ranging_checks(book),
        tables=(
            book.means_table(
                ("UAVs", "policy"), ("shape m", "estimates m", "busy %", "sessions/s", "completed %"),
                (
                    (str(agents), name, case)
                    for agents, entries in policies.items() for name, case in entries
                ),
            ),
        ),
        figures=(
            ReportFigure("codesign-ranging.png", "shape error against the occupancy of the channel", draw),
        ),
    )  # fmt: skip


def _ranging_checks(book: Book) -> tuple[Check, ...]:
    """Return the checks of all policies that do not exceed the capacity of the channel."""
    pairs = [
        all_pairs(agents, period_s) for agents, periods_s in FTM_PERIODS_S.items() for period_s in periods_s
    ]
    cases = [*(case for case in pairs if not case.last), *map(scheduled, FTM_PERIODS_S)]
    often = all_pairs(8, 0.1)
    shape_8, shape_16 = (
        book.ratio(scheduled(agents), all_pairs(agents, 1.0), "shape_m") for agents in FTM_PERIODS_S
    )
    busy_16 = book.ratio(scheduled(16), all_pairs(16, 1.0), "busy_fraction")
    busy_often, shape_often = (book.ratio(often, BASE, what) for what in ("busy_fraction", "shape_m"))
    shares = [
        book.mean(case, "busy_fraction").value / case.scenario(book.plan, 1).onboard.ranging_airtime
        for case in map(scheduled, FTM_PERIODS_S)
    ]
    return (
        checks.formed_check(book, cases),
        *checks.sound_checks(book, cases),
        checks.fewest_pairs_check((shape_8, shape_16, busy_16, busy_often, shape_often)),
        checks.largest_shape_check(book, cases, "any policy within the channel capacity"),
        Check(
            "share of ranging sessions that complete, any policy within the channel capacity, "
            "smallest mean",
            checks.extreme(book, cases, "completed_fraction", np.min), at_least=COMPLETED_LEAST,
        ),
        Check(
            "scheduled: occupancy of the channel over its configured share, largest", float(np.max(shares)),
            at_most=SHARE_MOST,
        ),
        Check(
            "8 UAVs: shape error scheduled over all pairs once a second, lower end", shape_8.low, at_most=1.0
        ),
        Check(
            "16 UAVs: shape error scheduled over all pairs once a second", shape_16.value,
            at_most=checks.NO_WORSE_MOST,
        ),
        Check(
            "16 UAVs: occupancy of the channel scheduled over all pairs once a second", busy_16.value,
            at_most=THRIFT_MOST,
        ),
        Check(
            "8 UAVs: occupancy of the channel, all pairs every 0.1 s over every second", busy_often.value,
            at_least=WASTE_LEAST,
        ),
        Check(
            "8 UAVs: shape error, all pairs every 0.1 s over every second", shape_often.value,
            at_least=WASTED_LEAST,
        ),
    )  # fmt: skip


def judge_baselines(book: Book) -> Section:
    """Compare sources of positions, one factor at a time."""
    cases = (
        ("true positions", TRUTH), ("FTM over an ideal channel", IDEAL),
        ("FTM over the emulated channel", BASE), ("GPS alone", GPS_ALONE),
    )  # fmt: skip
    held = (TRUTH, IDEAL, BASE)
    truth, ideal, emulated = (
        book.ratio(*pair, "shape_m") for pair in ((TRUTH, BASE), (IDEAL, BASE), (BASE, IDEAL))
    )
    return Section(
        title="Baselines",
        conditions=(
            "8 UAVs in 5 N. With true positions the remaining error is that of control. The ideal channel "
            "has no contention, collisions or fading; time stamps keep their errors.\n"
        ),
        checks=(
            checks.formed_check(book, (*held, GPS_ALONE)),
            *checks.sound_checks(book, held, "with FTM or true positions"),
            checks.fewest_pairs_check((truth, ideal)),
            Check("shape error with true positions over that with FTM, lower end", truth.low, at_most=1.0),
            Check("shape error with true positions over that with FTM", truth.value, at_least=CONTROLS_LEAST),
            Check(
                "shape error over an ideal channel over that over the emulated one, lower end", ideal.low,
                at_most=1.0,
            ),
            Check(
                "shape error over the emulated channel over that over an ideal one", emulated.value,
                at_most=checks.NO_WORSE_MOST,
            ),
        ),
        tables=(
            book.means_table(
                ("positions",), ("shape m", "estimates m", "control m", "absolute m"), cases
            ),
        ),
    )  # fmt: skip

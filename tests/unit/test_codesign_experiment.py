"""The co-design experiment without its flights: statistics, campaign on disk, judgement, page (25 s)."""

import csv
import json
import math
import os
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy import integrate, special
from typer.testing import CliRunner

from antenna.backend import BackendUnavailable, make_backend
from antenna.geometry import Snapshot, endfire_voltages, grid
from harness.codesign import cli, estimator_section, results
from harness.codesign.book import Book
from harness.codesign.cases import (
    BASE,
    BEACON_PERIODS_MS,
    GPS_ALONE,
    LIAR,
    LIAR_FROM_START,
    LOSSY,
    QUICK,
    Plan,
    cut,
    groups,
    liar_in_flight,
    wavelength,
)
from harness.codesign.measures import TRACK_PERIOD_S, Measures, Tables, measure
from harness.codesign.results import Flown, Store, fly_tasks, known, make_tasks, sources_state
from harness.codesign.sensitivity import expected_gain, per_axis_sigma_m, vertical_sigma_m
from harness.codesign.statistics import mean_interval, ratio_interval
from harness.codesign.study import LocalisationResult
from harness.codesign.trouble import judge_cut, judge_liar, shape_errors_ne_m, shape_over_time_m
from harness.faults import RadioAttenuation, RangingBias
from harness.validation.command import BAD_INPUT, FINE, MISSED

PLAN = Plan(seeds=10, duration_s=30.0)
PLACES_NED_M = BASE.scenario(PLAN, 1).places_ned_m()


# ---- statistics


def t_quantile(probability, freedom):
    """Student's quantile by quadrature of its density and bisection: nothing of what is under test."""
    scale = special.gamma((freedom + 1) / 2) / (math.sqrt(freedom * math.pi) * special.gamma(freedom / 2))

    def density(x):
        return scale * (1 + x * x / freedom) ** (-(freedom + 1) / 2)

    low, high = 0.0, 50.0
    for _ in range(60):
        middle = (low + high) / 2
        below = 0.5 + integrate.quad(density, 0.0, middle)[0] < probability
        low, high = (middle, high) if below else (low, middle)
    return low


def test_a_mean_has_students_interval():
    """1 to 5: deviation sqrt(2.5), so the mean 3 is known to t(0.975, 4) sqrt(2.5 / 5) = 1.963."""
    interval = mean_interval([1.0, 2.0, None, 3.0, 4.0, 5.0])
    half = t_quantile(0.975, 4) * math.sqrt(0.5)
    assert (interval.value, interval.count) == (3.0, 5)
    assert interval.high == pytest.approx(3.0 + half, rel=1e-6)
    assert interval.low == pytest.approx(3.0 - half, rel=1e-6)
    assert interval.text(2) == "3.00 (1.04 to 4.96)"
    assert mean_interval([4.0]).text(1) == "4.0"
    assert mean_interval([None]).text() == "–"


def test_a_mean_s_interval_holds_the_truth_in_95_of_100_campaigns():
    """4000 campaigns of ten: 95 % with a standard error of 0.34 %."""
    rng = np.random.default_rng(3)
    held = [
        (each := mean_interval(list(values))).low <= 1.0 <= each.high
        for values in rng.normal(1.0, 0.3, (4000, 10))
    ]
    assert np.mean(held) == pytest.approx(0.95, abs=0.012)


def test_a_ratio_is_of_the_means_and_its_interval_is_of_pairs():
    """What both flights of a pair share cancels: here all of it, and only 1 % per pair is left.

    Pairs (c, 5 c (1 + e)) with c from 0.1 to 0.9: a ratio of means taken apart would be known to some 20 %.
    """
    rng = np.random.default_rng(4)
    below = rng.uniform(0.1, 0.9, 10)
    above = 5.0 * below * (1.0 + rng.normal(0.0, 0.01, 10))
    interval = ratio_interval([*above, None, 1.0], [*below, 1.0, None])
    assert interval.value == pytest.approx(above.mean() / below.mean())
    assert interval.count == 10
    assert interval.low < interval.value < interval.high
    assert interval.high - interval.low < 0.1
    exact = ratio_interval(5.0 * below, below)
    assert exact.low == exact.high == pytest.approx(5.0)
    assert ratio_interval([2.0], [1.0]).text(1) == "2.0"
    assert ratio_interval([None], [1.0]).count == 0
    assert ratio_interval([1.0, 1.0], [0.0, 0.0]).count == 0


def test_a_ratio_s_interval_holds_the_truth():
    """Lognormal pairs of ratio 6; with ten pairs the bootstrap is a little short of its 95 %."""
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(150):
        below = rng.lognormal(0.0, 0.3, 10)
        above = 6.0 * rng.lognormal(0.0, 0.3, 10)
        interval = ratio_interval(above, below)
        held += interval.low <= 6.0 <= interval.high
    assert 0.86 <= held / 150 <= 0.99


# ---- the antenna's expectation


def test_expected_gain_goes_through_the_table_in_between_and_no_further():
    assert expected_gain(0.5, 10).mean_dbi == pytest.approx(12.62)
    assert expected_gain(0.5, 5).mean_dbi == expected_gain(1.0, 10).mean_dbi == pytest.approx(11.04)
    assert expected_gain(0.0, 10).mean_dbi == pytest.approx(13.26)
    gains = [expected_gain(sigma_m, 10).mean_dbi for sigma_m in np.linspace(0.0, 4.0, 200)]
    assert np.all(np.diff(gains) <= 1e-9)
    assert expected_gain(9.0, 10) == expected_gain(4.0, 10)
    with pytest.raises(ValueError, match="sigma_m"):
        expected_gain(math.nan, 10)


@pytest.mark.nec2
def test_expected_gain_is_what_drawn_errors_give():
    """Between the table's points, at sigma / lambda = 0.03: 40 draws know the mean to 0.14 / sqrt(40) dB.

    The interpolation between 12.9 dBi of neighbours is allowed a tenth of a decibel beside that.
    """
    config = BASE.scenario(PLAN, 1).antenna
    try:
        backend = make_backend(config)
    except BackendUnavailable as error:
        pytest.skip(str(error))
    rng = np.random.default_rng(6)
    centres_m = grid(8, 4, 8.5, 2.5)
    snapshots = [
        Snapshot(
            centres_m=centres_m + rng.normal(0.0, 0.3, (8, 3)),
            axes=np.tile((0.0, 0.0, 1.0), (8, 1)),
            voltages=endfire_voltages(centres_m, 10.0),
        )
        for _ in range(40)
    ]
    gains = [pattern.max_gain_dbi for pattern in backend.patterns(snapshots)]
    expected = expected_gain(0.3, 10.0)
    assert np.mean(gains) == pytest.approx(expected.mean_dbi, abs=0.1 + 2 * 0.14 / math.sqrt(40))
    assert np.std(gains) == pytest.approx(expected.std_db, rel=0.5)


def test_sigma_is_what_was_drawn():
    """Independent errors of 0.2 m, aligned: the rms comes back to sigma by the degrees of freedom left."""
    rng = np.random.default_rng(7)
    errors_m = rng.normal(0.0, 0.2, (2000, 8, 3))
    left = shape_errors_ne_m(errors_m[..., :2], PLACES_NED_M)
    rms_m = math.sqrt((left**2).sum(axis=-1).mean())
    assert per_axis_sigma_m(rms_m, 8) == pytest.approx(0.2, rel=0.01)
    heights_m = errors_m[..., 2] - errors_m[..., 2].mean(axis=1, keepdims=True)
    assert vertical_sigma_m(math.sqrt((heights_m**2).mean()), 8) == pytest.approx(0.2, rel=0.01)


# ---- cases


def test_every_case_is_a_scenario_that_differs_as_its_name_says():
    plan = Plan(seeds=1)
    cases = {case.name: case for members in groups(plan).values() for case in members}
    assert len({msgspec.json.encode((case.scenario(plan, 1), case.faults)) for case in cases.values()}) == 38
    assert {case.name for case in groups(plan)["wavelength"]} & {
        case.name for case in groups(plan)["wind_agents"]
    }
    for case in cases.values():
        scenario = case.scenario(plan, 7)
        assert (scenario.run.seed, scenario.name) == (7, case.name)
        assert scenario.onboard.localisation == case.name.partition("-")[0]
        assert (scenario.formation.columns, scenario.formation.rows) == (case.agents // 2, 2)
        assert scenario.sensors.profile == "consumer"
    base = BASE.scenario(plan, 1)
    assert (base.agents, base.wind.mean_n, base.antenna.wavelength_m, base.run.duration_s) == (8, 5, 10, 30)
    assert LOSSY.scenario(plan, 1).radio.drop_fraction == 0.3
    (lie,) = LIAR_FROM_START.scenario(plan, 1).faults
    assert isinstance(lie, RangingBias)
    assert (lie.uav, lie.offset_m, lie.start_s) == (LIAR, 5.0, 0.0)
    tight = wavelength("ftm", 5, 2).scenario(plan, 1)
    assert np.ptp(tight.places_ned_m()[:, 0]) == pytest.approx(1.25)


def test_a_cut_of_ten_seconds_leaves_twenty_to_recover():
    (fault,) = cut(PLAN).faults
    assert isinstance(fault, RadioAttenuation)
    assert (fault.uav, fault.start_s, fault.duration_s) == ("all", 10.0, 10.0)
    assert cut(PLAN).scenario(PLAN, 1).run.duration_s == 40.0
    assert liar_in_flight(PLAN).faults[0].start_s == 5.0
    assert cut(QUICK).scenario(QUICK, 1).run.duration_s == pytest.approx(4 * QUICK.cut_s)


# ---- what is measured


def tables_of(pos_ned_m, *, own_ned_m=None, collisions_us=(), sessions=40):
    """50 rows per second from 1 s on; the channel is busy a tenth of the time."""
    instants, vehicles = pos_ned_m.shape[:2]
    time_us = 1_000_000 + 20_000 * np.arange(instants)
    return Tables(
        time_us=time_us,
        alive=np.ones((instants, vehicles), dtype=bool),
        pos_ned_m=pos_ned_m,
        q_ned_frd=np.tile((1.0, 0.0, 0.0, 0.0), (instants, vehicles, 1)),
        own_pos_ned_m=pos_ned_m.copy() if own_ned_m is None else own_ned_m,
        air_us=time_us,
        busy_ns=time_us * 100,
        session_us=np.linspace(time_us[0], time_us[-1], sessions).astype(np.int64),
        session_ok=np.arange(sessions) % 4 > 0,
        session_by=np.arange(sessions) % vehicles,
        session_error_m=np.where(np.arange(sessions) % vehicles == 5, 5.0, 0.0),
        collisions_us=tuple(collisions_us),
    )


def test_a_flight_s_errors_are_taken_apart():
    """Where the vehicles believe to be is where they should be: all the error is of the estimates.

    The formation is shifted and turned as a whole besides, which is an absolute error and none of shape.
    """
    rng = np.random.default_rng(8)
    turn = np.array(((math.cos(0.1), -math.sin(0.1)), (math.sin(0.1), math.cos(0.1))))
    pos_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    pos_ned_m[..., :2] = pos_ned_m[..., :2] @ turn.T + (3.0, 4.0)
    wrong_m = rng.normal(0.0, 0.2, (500, 8, 2))
    pos_ned_m[..., :2] += wrong_m
    own_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    own_ned_m[:50, 0] = np.nan  # not known at first
    scenario = BASE.scenario(PLAN, 1)
    tables = tables_of(pos_ned_m, own_ned_m=own_ned_m)
    measures = measure(tables, scenario, formed_us=2_000_000, wall_s=2.0, gains=False)
    expected_m = 0.2 * math.sqrt(2.0 - 3.0 / 8.0)
    assert measures.shape_m == pytest.approx(expected_m, rel=0.03)
    assert measures.shape_whole_m == measures.shape_m
    assert measures.estimate_m == pytest.approx(expected_m, rel=0.03)
    assert measures.control_m == pytest.approx(0.0, abs=1e-9)
    assert measures.absolute_m > 4.0
    assert measures.vertical_m == pytest.approx(0.0, abs=1e-9)
    assert measures.busy_fraction == pytest.approx(0.1)
    assert measures.completed_fraction == pytest.approx(0.75, abs=0.03)
    assert measures.sessions_per_s == pytest.approx(40 / 9.98, rel=0.05)
    assert measures.real_time_factor == pytest.approx(10.98 / 2.0)
    # vehicles 0 and 4 have every fourth session, which failed; two in a row are 2 / 39 of 9.98 s apart
    assert measures.range_offsets_m == (None, 0.0, 0.0, 0.0, None, 5.0, 0.0, 0.0)
    assert measures.longest_silence_s == pytest.approx(2 * 9.98 / 39, rel=1e-3)
    assert (measures.collisions, measures.down, measures.gain_dbi) == (0, 0, ())
    track_ne_m = measures.track_ne_m
    assert track_ne_m.shape == (45, 8, 2)
    np.testing.assert_allclose(track_ne_m[3], (pos_ned_m - PLACES_NED_M)[50 + 30, :, :2], atol=6e-4)
    assert shape_over_time_m(track_ne_m, PLACES_NED_M).mean() == pytest.approx(expected_m, rel=0.05)


def test_after_a_fall_shape_is_that_of_a_wreck():
    """Two come within 0.5 m 4 s after the formation, and one falls 2 s later: what counts ends there.

    Vehicles on the ground are near nobody. Until the fall one of 300 rows has vehicle 1 where it touches, off
    by the distance d of the places 0 and 1 less half a metre: its rms is that of what the alignment leaves.
    """
    pos_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    hit = 50 + 200
    pos_ned_m[hit, 1] = pos_ned_m[hit, 0] + (0.3, 0.4, 0.0)
    pos_ned_m[hit + 100 :, 1] = (50.0, 50.0, -0.1)
    pos_ned_m[hit + 100 :, 2] = (50.0, 50.1, -0.1)
    tables = tables_of(pos_ned_m, collisions_us=[1_000_000 + hit * 20_000])
    scenario = BASE.scenario(PLAN, 1)
    measures = measure(tables, scenario, formed_us=2_000_000, wall_s=0.0, gains=False)
    left_m = shape_over_time_m((pos_ned_m - PLACES_NED_M)[[hit], :, :2], PLACES_NED_M)[0]
    assert measures.shape_m == pytest.approx(left_m / math.sqrt(300))
    assert measures.shape_whole_m > 5.0
    assert measures.least_distance_m == measures.least_distance_formed_m == pytest.approx(0.5)
    assert (measures.collisions, measures.down) == (1, 2)
    assert measures.first_collision_s == pytest.approx(6.0)
    assert measures.real_time_factor is None
    early = measure(tables, scenario, formed_us=9_000_000, wall_s=1.0, gains=False)
    assert early.shape_m is None
    assert early.shape_whole_m > 5.0
    never = measure(tables, scenario, formed_us=None, wall_s=1.0, gains=False)
    assert (never.formed_s, never.shape_m, never.track_mm) == (None, None, ())
    assert never.collisions == 1


# ---- trouble


def shape_series(seconds, changes):
    """(T,) shape error: the last of ``(from_s, error_m)`` that holds."""
    time_s = TRACK_PERIOD_S * np.arange(round(seconds / TRACK_PERIOD_S))
    values = np.zeros(len(time_s))
    for from_s, error_m in changes:
        values[time_s >= from_s - 1e-9] = error_m
    return values


def test_recovery_is_when_the_error_is_small_for_good():
    """0.2 m before and 1 m during; back at 0.2 m 2.4 s after the return, with a relapse before that.

    The rms of the last second is below 0.25 m when as many of its five squares are small, so 4 (0.2)^2 +
    1^2 is too much and only five small ones will do: 0.8 s after the first.
    """
    shape_m = shape_series(40.0, [(0, 0.2), (12, 1.0), (20.4, 0.2), (21.6, 1.0), (22.4, 0.2)])
    result = judge_cut(shape_m, cut_at_s=10.0, cut_s=10.0)
    assert result.before_m == pytest.approx(0.2)
    assert result.during_m == pytest.approx(math.sqrt((0.2**2 * 10 + 1.0 * 40) / 50))
    assert result.recovery_s == pytest.approx(2.4 + 0.8)
    assert result.after_m == pytest.approx(0.2)
    never = judge_cut(shape_series(40.0, [(0, 0.2), (12, 1.0)]), cut_at_s=10.0, cut_s=10.0)
    assert math.isinf(never.recovery_s)
    assert math.isnan(never.after_m)
    unharmed = judge_cut(shape_series(40.0, [(0, 0.2)]), cut_at_s=10.0, cut_s=10.0)
    assert unharmed.recovery_s == 0.0


def test_what_was_large_before_may_be_a_fifth_larger_after():
    shape_m = shape_series(40.0, [(0, 0.5), (12, 1.0), (25.0, 0.59)])
    assert judge_cut(shape_m, cut_at_s=10.0, cut_s=10.0).recovery_s == pytest.approx(5.0 + 0.8)
    shape_m = shape_series(40.0, [(0, 0.5), (12, 1.0), (25.0, 0.61)])
    assert math.isinf(judge_cut(shape_m, cut_at_s=10.0, cut_s=10.0).recovery_s)


def test_a_pull_is_what_differs_between_two_flights_of_a_seed():
    """One of the others is 0.4 m off from 10 s on, the liar itself 9 m, the whole shifted by 2 m.

    Alignment spreads the 0.4 m: the seven are laid over their places by the mean, which takes a seventh.
    The turn takes a little more, which depends on where the vehicle stands.
    """
    rng = np.random.default_rng(9)
    usual_ne_m = rng.normal(0.0, 0.1, (150, 8, 2))
    lying_ne_m = usual_ne_m.copy()
    lying_ne_m[50:] += (2.0, 0.0)
    lying_ne_m[50:, LIAR] += 9.0
    lying_ne_m[50:, 0, 0] += 0.4
    pull = judge_liar(lying_ne_m, usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=5.0)
    assert 0.5 * 0.4 < pull.displacement_m < 0.4 * 6 / 7 + 0.02
    assert pull.lasting_m == pytest.approx(pull.displacement_m * 100 / 125, rel=0.1)
    assert pull.shift_m == pytest.approx(2.0 + 0.4 / 7, rel=1e-6)
    assert pull.shape_m > pull.shape_without_m
    same = judge_liar(usual_ne_m, usual_ne_m[:120], PLACES_NED_M, liar=LIAR, from_s=5.0)
    assert same.displacement_m == same.shift_m == 0.0
    short = judge_liar(lying_ne_m[:51], usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=10.0)
    assert short.shift_m > 1.9


# ---- a campaign on disk


def flown(task, **numbers):
    measures = Measures(
        **{
            "formed_s": 20.0, "simulated_s": 50.0, "wall_s": 10.0, "real_time_factor": 5.0, "collisions": 0,
            "first_collision_s": None, "down": 0, "least_distance_m": 2.0,
        } | numbers
    )  # fmt: skip
    return Flown(case=task.case, seed=task.seed, digest=task.digest, measures=measures)


def fly_noted(task):
    """Leave a mark of each flight; one breaks, one kills its process, all others land."""
    marks = Path(task.folder).parents[1] / "marks"
    with marks.open("a") as file:
        file.write(f"{task.case} {task.seed}\n")
    if task.case == LOSSY.name and task.seed == 2:
        return Flown(case=task.case, seed=task.seed, digest=task.digest, broken="fell into the sea")
    if task.case == GPS_ALONE.name and task.seed == 1:
        time.sleep(0.3)  # so that somebody else is in the air
        os._exit(3)
    return flown(task, shape_m=0.1 * task.seed)


def marks_of(folder):
    marks = folder / "marks"
    return marks.read_text().splitlines() if marks.exists() else []


def test_a_campaign_flies_each_flight_once_and_goes_on_after_losses(tmp_path, monkeypatch):
    """A killed worker costs its own flight alone; a second run flies nothing; a changed one flies anew."""
    monkeypatch.setattr(results, "START_METHOD", "fork")  # spawned ones would import all of this
    plan, cases = Plan(seeds=2), (BASE, GPS_ALONE, LOSSY, BASE)
    tasks = make_tasks(cases, plan, folder=tmp_path, state="one")
    assert [(task.case, task.seed) for task in tasks] == [
        (case.name, seed) for seed in (1, 2) for case in (BASE, GPS_ALONE, LOSSY)
    ]
    store, heard = Store(tmp_path), []
    fly_tasks(tasks, store, fly_noted, workers=2, done=heard.append)
    assert sorted((each.case, each.seed) for each in heard) == sorted(
        (each.case, each.seed) for each in tasks
    )
    reasons = {(each.case, each.seed): each.broken for each in store.flights() if each.broken}
    assert reasons == {(GPS_ALONE.name, 1): "its process died", (LOSSY.name, 2): "fell into the sea"}
    with store.path.open("ab") as file:
        file.write(b'{"case": "ftm-8-5n", "seed": 1, "dig')  # killed while it wrote
    there = known(tasks, Store(tmp_path))
    assert len(there) == len(tasks)
    assert there[BASE.name, 2].measures.shape_m == pytest.approx(0.2)
    store.append(flown(tasks[0], shape_m=7.0))
    assert known(tasks, store)[BASE.name, 1].measures.shape_m == 7.0  # the latest, on a line of its own
    later = make_tasks(cases, plan, folder=tmp_path, state="another")
    assert known(later, store) == {}
    assert len(known(later, store, stale=True)) == len(tasks)
    assert known(make_tasks(cases, replace(plan, duration_s=8.0), folder=tmp_path, state="one"), store) == {}


def test_the_state_of_the_sources_is_what_they_do(tmp_path):
    """Comments, docstrings and layout change nothing; a number does, wherever it flies."""
    for package in ("antenna", "netsim", "autopilot", "harness/codesign"):
        (tmp_path / package).mkdir(parents=True)
    flying, telling = tmp_path / "autopilot" / "a.py", tmp_path / "harness" / "codesign" / "cli.py"
    flying.write_text('"""One."""\n\n\ndef f(x):\n    """Two."""\n    return x + 1\n')
    telling.write_text("A = 1\n")
    first = sources_state(tmp_path)
    sources_state.cache_clear()
    flying.write_text('"""Three."""\ndef f(x):\n    # four\n    return (x + 1)\n')
    telling.write_text("A = 2\n")
    assert sources_state(tmp_path) == first
    sources_state.cache_clear()
    flying.write_text("def f(x):\n    return x + 2\n")
    assert sources_state(tmp_path) != first
    sources_state.cache_clear()


# ---- judgement


def made_up(
    plan, *, ftm_m=0.2, gps_m=1.5, liar_pull_m=0.0, recovers=True, drop_grows=1.2, cuts=True, tells=True
):
    """A book in which everything was flown: ``ftm_m`` of shape error give or take a twentieth by seed."""
    rng = np.random.default_rng(10)
    flights = {}
    for case in {case.name: case for members in groups(plan).values() for case in members}.values():
        for seed in range(1, plan.seeds + 1):
            luck = 1.0 + 0.05 * np.random.default_rng(seed).standard_normal()
            shape_m = luck * (gps_m if case.localisation == "gps" else ftm_m)
            if case.drop_fraction:
                shape_m *= drop_grows
            instants = round((plan.duration_s + case.longer_s) / TRACK_PERIOD_S)
            track_ne_m = np.random.default_rng([seed, 1]).normal(
                0.0, shape_m / math.sqrt(2), (instants, case.agents, 2)
            )
            lies = tells and (case.lies or any(isinstance(fault, RangingBias) for fault in case.faults))
            if lies:
                begin = 0 if case.lies else round(plan.liar_after_s / TRACK_PERIOD_S)
                track_ne_m[begin:, 0, 0] += liar_pull_m
            if case == cut(plan):
                begin = round(plan.cut_s / TRACK_PERIOD_S)
                track_ne_m[begin : 2 * begin + 20 if recovers else None] *= 4.0
            track_mm = np.rint(1e3 * track_ne_m).astype(int)
            collided = case.localisation == "gps" and seed % 2
            numbers = {
                "formed_s": 18.0, "simulated_s": 48.0, "wall_s": 10.0, "real_time_factor": 4.8,
                "collisions": int(collided), "first_collision_s": 40.0 if collided else None,
                "down": 2 * int(collided), "least_distance_m": 0.4 if collided else 1.9,
                "least_distance_formed_m": 1.9, "shape_m": shape_m, "shape_whole_m": shape_m,
                "absolute_m": 1.5, "vertical_m": 0.1, "estimate_m": 0.7 * shape_m, "control_m": 0.7 * shape_m,
                "busy_fraction": 0.02 * case.agents, "sessions_per_s": 56.0, "completed_fraction": 0.98,
                "longest_silence_s": plan.cut_s if case == cut(plan) and cuts else 0.1,
                "range_offsets_m": tuple(5.0 * (lies and i == LIAR) for i in range(case.agents)),
                "gain_dbi": tuple(rng.normal(13.0, 0.1, 30)) if case.gains else (),
                "track_mm": tuple(map(tuple, track_mm.reshape(instants, -1).tolist())),
            }  # fmt: skip
            flights[case.name, seed] = Flown(
                case=case.name, seed=seed, digest="x", measures=Measures(**numbers)
            )
    return Book(plan=plan, flights=flights)


def judged(book, images=None):
    return {name: judge(book, images) for name, judge in cli.JUDGES.items()}


def missed(sections):
    return [check.name for section in sections.values() for check in section.checks if not check.passed]


def test_a_campaign_that_meets_everything_passes_and_is_drawn(tmp_path):
    sections = judged(made_up(PLAN), tmp_path)
    assert missed(sections) == []
    drawn = [name for section in sections.values() for name, _ in section.figures]
    assert len(drawn) == 6
    assert all((tmp_path / name).stat().st_size > 10_000 for name in drawn)
    checks = {check.name: check for section in sections.values() for check in section.checks}
    assert checks["GPS alone over FTM there"].value == pytest.approx(1.5 / 0.2)
    (rows,) = [table.rows for table in sections["wavelength"].tables]
    assert len(rows) == 8
    cell = dict(zip(sections["wavelength"].tables[0].columns, rows[-1], strict=True))
    assert (cell["λ m"], cell["wind N"], cell["positions by"]) == ("10", "5", "with FTM")
    assert float(cell["σ horizontal m"]) == pytest.approx(0.2 / math.sqrt(1.625), rel=0.06)
    assert cell["expected for σ/λ dBi"].startswith("13.1")
    assert "collides in 5 of 10 flights" in sections["wavelength"].tables[0].caption
    assert len(sections["beacon_period"].tables[0].rows) == len(BEACON_PERIODS_MS)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"ftm_m": 0.26, "gps_m": 2.0}, ["shape error with FTM, 8 UAVs, 5 N, mean"]),
        ({"gps_m": 0.97}, ["GPS alone over FTM there"]),
        ({"drop_grows": 1.55}, ["30% of beacons and distances lost: growth of the shape error"]),
        ({"cuts": False}, ["cut: time without any distance, shortest"]),
        ({"tells": False}, ["liar: error of the distances that it measures, median, smallest"]),
        ({"recovers": False}, ["cut: recovery from the channel's return, slowest"]),
        (
            {"liar_pull_m": 0.8},
            [
                "liar in flight: displacement of another over 2 s, largest",
                "liar from the start: lasting displacement of another, largest",
            ],
        ),
    ],
)
def test_each_line_is_judged_by_its_own_number(changes, expected):
    assert missed(judged(made_up(PLAN, **changes))) == expected


def test_too_few_flights_are_not_enough():
    assert missed(judged(made_up(replace(PLAN, seeds=4)))) == ["flights with numbers"] * 2


def test_a_collision_at_five_metres_is_seen():
    book = made_up(PLAN)
    tight = wavelength("ftm", 5, 2)
    old = book.flights[tight.name, 3]
    bumped = replace(old, measures=replace(old.measures, collisions=1))
    lost = replace(old, measures=None, broken="no vehicle is left")
    for changed, expected in (
        (bumped, ["λ = 5 m, 2 N, FTM: flights with a collision"]),
        (lost, ["flights with numbers"]),
    ):
        worse = replace(book, flights=dict(book.flights) | {(tight.name, 3): changed})
        assert missed(judged(worse)) == expected


def test_nothing_flown_is_nothing_met(tmp_path):
    """No number is made up, and nothing breaks for the lack of them; 7 checks are of troubles."""
    sections = judged(Book(plan=PLAN, flights={}), tmp_path)
    checks = [check for section in sections.values() for check in section.checks]
    assert len(missed(sections)) == len(checks) == 3 + 3 + 7


def fake_study(setting, runs):
    """Ten runs of 8 UAVs have 130 degrees of freedom: the mean NEES of a consistent filter is 13."""
    return LocalisationResult(
        count=setting.agents, loss=setting.loss, scheduled=setting.scheduled, runs=runs, bound_m=0.1,
        filter_m=0.149 if setting.batch else 0.2, batch_m=0.12 if setting.batch else None, predicted_m=0.1,
        nees=14.0, nees_band=(10.0, 16.0),
    )  # fmt: skip


def test_studies_are_done_once_for_a_state_and_a_number_of_runs(tmp_path, monkeypatch):
    """Only the article's geometry is held to 1.5 times the bound."""
    monkeypatch.setattr(estimator_section, "START_METHOD", "fork")
    monkeypatch.setattr(estimator_section, "study", fake_study)
    seen = []

    def go(plan):
        seen.clear()
        return estimator_section.studies(plan, tmp_path, workers=2, done=lambda *told: seen.append(told))

    first = go(Plan(seeds=1))
    assert seen == [(done, 5) for done in range(6)]
    section = estimator_section.judge_estimator(first)
    assert [check.passed for check in section.checks] == [True, True]
    assert section.checks[0].value == pytest.approx(1.49)
    assert [row[0] for row in section.tables[0].rows] == ["8", "8", "8", "4", "16"]
    monkeypatch.setattr(estimator_section, "study", None)  # nothing is studied again ...
    assert go(Plan(seeds=1)) == first
    assert seen == [(5, 5)]
    monkeypatch.setattr(estimator_section, "study", fake_study)
    assert go(Plan(seeds=2)) != first  # ... but for another number of runs
    monkeypatch.setattr(estimator_section, "_state", lambda: "another")
    go(Plan(seeds=1))
    assert seen[0] == (0, 5)


# ---- the command line


def fly_made_up(task):
    return flown(task, shape_m=0.2, busy_fraction=0.05, completed_fraction=1.0)


@pytest.fixture
def no_flying(monkeypatch):
    """A campaign whose flights land at once, in this process, and are counted."""
    flights = []

    def fly_here(tasks, store, _fly, *, done, **_):
        for task in tasks:
            result = fly_made_up(task)
            if (task.case, task.seed) == (BASE.name, 2):
                result = Flown(case=task.case, seed=task.seed, digest=task.digest, broken="SwarmError: lost")
            flights.append(task)
            store.append(result)
            done(result)

    monkeypatch.setattr(cli, "fly_tasks", fly_here)
    monkeypatch.setattr(cli.kernel_cache, "prepare", lambda _: None)
    return flights


def run_cli(*arguments):
    return CliRunner().invoke(cli.codesign_app, [str(argument) for argument in arguments])


def test_a_second_run_flies_nothing_and_writes_the_same_page(tmp_path, no_flying, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    arguments = (
        "--only", "baselines", "--seeds", 3, "--data", tmp_path / "data", "--out", tmp_path / "docs",
    )  # fmt: skip
    first = run_cli(*arguments)
    assert first.exit_code == FINE, first.output
    assert len(no_flying) == 4 * 3
    page = (tmp_path / "docs" / "codesign-results.md").read_text()
    assert "| FTM over the emulated channel | 0.200 (0.200 to 0.200) |" in page
    assert "- ftm-8-5n, seed 2: SwarmError: lost" in page
    assert "12 flights" in page
    with (tmp_path / "docs" / "codesign-flights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 11
    assert {row["shape_m"] for row in rows} == {"0.2"}
    with (tmp_path / "docs" / "codesign-cases.csv").open() as file:
        means = {row["case"]: row for row in csv.DictReader(file)}
    assert (means[BASE.name]["flights"], means[GPS_ALONE.name]["flights"]) == ("2", "3")
    second = run_cli(*arguments)
    assert second.exit_code == FINE
    assert len(no_flying) == 12
    assert (tmp_path / "docs" / "codesign-results.md").read_text() == page
    retried = run_cli(*arguments, "--retry")
    assert retried.exit_code == FINE
    assert [(task.case, task.seed) for task in no_flying[12:]] == [(BASE.name, 2)]
    longer = run_cli(*arguments, "--duration", 40)
    assert longer.exit_code == FINE
    assert len(no_flying) == 12 + 1 + 12


@pytest.mark.usefixtures("no_flying")
def test_json_is_the_checks_and_unmet_ones_are_the_exit_status(tmp_path, monkeypatch):
    monkeypatch.setattr(cli, "keep_stdout", lambda: sys.stdout)
    result = run_cli("--only", "wind_agents", "--quick", "--json", "--data", tmp_path)
    assert result.exit_code == MISSED
    numbers = {each["name"]: each for each in json.loads(result.stdout)}
    assert numbers["shape error with FTM, 8 UAVs, 5 N, mean"]["met"] is True
    assert numbers["GPS alone over FTM there"]["value"] == pytest.approx(1.0)
    assert numbers["GPS alone over FTM there"]["at_least"] == 5.0


def test_an_unknown_group_is_one_line():
    result = run_cli("--only", "wind_agents,nonsense")
    assert result.exit_code == BAD_INPUT
    assert "nonsense" in result.stderr
    assert result.stderr.count("\n") <= 2

"""Tests of the co-design experiment: cases, measures of a flight, statistics of many (10 s)."""

import math

import msgspec
import numpy as np
import pytest
from scipy import integrate, special

from antenna.model.excitation import end_fire
from antenna.model.geometry import Snapshot, grid
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.selection import make_backend
from autopilot.onboard.radio.scheduled_ranging import owner
from harness.campaign.intervals import mean_interval
from harness.launch import swarm
from harness.records.flight import Flight
from harness.world.faults import RadioAttenuation, RangingBias
from studies.codesign.cases import (
    BASE,
    LIAR,
    LIAR_FROM_START,
    LOSSY,
    QUICK,
    CodesignPlan,
    cut,
    groups,
    liar_in_flight,
    wavelength,
)
from studies.codesign.measures import TRACK_PERIOD_S, FlightTables, measure
from studies.codesign.sensitivity import expected_gain, per_axis_sigma_m, vertical_sigma_m
from studies.codesign.simulated import simulate
from studies.codesign.statistics import ratio_interval
from studies.codesign.trouble import judge_cut, judge_liar, shape_errors_ne_m, shape_over_time_m

PLAN = CodesignPlan(seeds=10, duration_s=30.0)
PLACES_NED_M = BASE.scenario(PLAN, 1).places_ned_m()


# ---- statistics


def t_quantile(probability, freedom):
    """Return Student's quantile by quadrature of its density and bisection, for an independent test."""
    scale = special.gamma((freedom + 1) / 2) / (math.sqrt(freedom * math.pi) * special.gamma(freedom / 2))

    def density(x):
        return scale * (1 + x * x / freedom) ** (-(freedom + 1) / 2)

    low, high = 0.0, 50.0
    for _ in range(60):
        middle = (low + high) / 2
        below = 0.5 + integrate.quad(density, 0.0, middle)[0] < probability
        low, high = (middle, high) if below else (low, middle)
    return low


def test_mean_has_students_interval():
    """1 to 5: deviation sqrt(2.5), so the interval of the mean 3 is ± t(0.975, 4) sqrt(2.5 / 5) = 1.963."""
    interval = mean_interval([1.0, 2.0, None, 3.0, 4.0, 5.0])
    half = t_quantile(0.975, 4) * math.sqrt(0.5)
    assert (interval.value, interval.count) == (3.0, 5)
    assert interval.high == pytest.approx(3.0 + half, rel=1e-6)
    assert interval.low == pytest.approx(3.0 - half, rel=1e-6)
    assert interval.text(2) == "3.00 (1.04 to 4.96)"
    assert mean_interval([4.0]).text(1) == "4.0"
    assert mean_interval([None]).text() == "–"


def test_mean_interval_has_95_percent_coverage():
    """4000 campaigns of ten: 95 % with a standard error of 0.34 %."""
    rng = np.random.default_rng(3)
    held = [
        (each := mean_interval(list(values))).low <= 1.0 <= each.high
        for values in rng.normal(1.0, 0.3, (4000, 10))
    ]
    assert np.mean(held) == pytest.approx(0.95, abs=0.012)


def test_ratio_is_of_means_with_an_interval_over_pairs():
    """Common errors of a pair cancel: here all of them, except 1 % per pair.

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


def test_ratio_interval_covers_the_truth():
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


def test_expected_gain_interpolates_the_table_and_does_not_extrapolate():
    assert expected_gain(0.5, 10).mean_dbi == pytest.approx(12.62)
    assert expected_gain(0.5, 5).mean_dbi == expected_gain(1.0, 10).mean_dbi == pytest.approx(11.04)
    assert expected_gain(0.0, 10).mean_dbi == pytest.approx(13.26)
    gains = [expected_gain(sigma_m, 10).mean_dbi for sigma_m in np.linspace(0.0, 4.0, 200)]
    assert np.all(np.diff(gains) <= 1e-9)
    assert expected_gain(9.0, 10) == expected_gain(4.0, 10)
    with pytest.raises(ValueError, match="sigma_m"):
        expected_gain(math.nan, 10)


@pytest.mark.nec2
def test_expected_gain_agrees_with_drawn_errors():
    """Between the table's points, at sigma / lambda = 0.03; 40 draws have an error of 0.14 / sqrt(40) dB.

    The tolerance of the interpolation between neighbours at 12.9 dBi is 0.1 dB in addition.
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
            rotations=np.tile(np.eye(3), (8, 1, 1)),
            voltages=end_fire(centres_m, 10.0),
        )
        for _ in range(40)
    ]
    gains = [pattern.max_gain_dbi for pattern in backend.patterns(snapshots)]
    expected = expected_gain(0.3, 10.0)
    assert np.mean(gains) == pytest.approx(expected.mean_dbi, abs=0.1 + 2 * 0.14 / math.sqrt(40))
    assert np.std(gains) == pytest.approx(expected.std_db, rel=0.5)


def test_sigma_recovers_the_drawn_deviation():
    """Independent errors of 0.2 m, aligned: the rms gives sigma with the remaining degrees of freedom."""
    rng = np.random.default_rng(7)
    errors_m = rng.normal(0.0, 0.2, (2000, 8, 3))
    left = shape_errors_ne_m(errors_m[..., :2], PLACES_NED_M)
    rms_m = math.sqrt((left**2).sum(axis=-1).mean())
    assert per_axis_sigma_m(rms_m, 8) == pytest.approx(0.2, rel=0.01)
    heights_m = errors_m[..., 2] - errors_m[..., 2].mean(axis=1, keepdims=True)
    assert vertical_sigma_m(math.sqrt((heights_m**2).mean()), 8) == pytest.approx(0.2, rel=0.01)


# ---- cases


def test_each_case_is_a_scenario_that_matches_its_name():
    plan = CodesignPlan(seeds=1)
    cases = {case.name: case for members in groups(plan).values() for case in members}
    assert len({msgspec.json.encode((case.scenario(plan, 1), case.faults)) for case in cases.values()}) == 37
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
    assert (base.agents, base.wind.mean_n, base.antenna.wavelength_m, base.run.duration_s) == (8, 5, 10, 15)
    assert LOSSY.scenario(plan, 1).radio.drop_fraction == 0.3
    (lie,) = LIAR_FROM_START.scenario(plan, 1).faults
    assert isinstance(lie, RangingBias)
    assert (lie.uav, lie.offset_m, lie.start_s) == (LIAR, 5.0, 0.0)
    tight = wavelength("ftm", 5, 2).scenario(plan, 1)
    assert np.ptp(tight.places_ned_m()[:, 0]) == pytest.approx(1.25)


def test_simulated_pairs_have_the_initiator_of_the_policy():
    """Each pair has one initiator, its owner, in the simulation as in flight."""
    for count in range(2, 10):
        flown = simulate(
            places_ned_m=np.pad(10.0 * np.arange(count)[:, None], ((0, 0), (0, 2))),
            duration_s=2.0, rng=np.random.default_rng(count), scheduled=True,
        )  # fmt: skip
        seen = {(item.initiator, item.responder) for item in flown.known()[1]}
        pairs = {(i, j) for i in range(count) for j in range(count) if i != j}
        assert seen == {(i, j) for i, j in pairs if owner(i, j, count) == i}
        assert len(seen) == count * (count - 1) // 2


def test_outage_of_ten_seconds_leaves_twenty_to_recover():
    (fault,) = cut(PLAN).faults
    assert isinstance(fault, RadioAttenuation)
    assert (fault.uav, fault.start_s, fault.duration_s) == ("all", 10.0, 10.0)
    assert fault.attenuation_db == swarm.CUT_DB
    assert cut(PLAN).scenario(PLAN, 1).run.duration_s == 40.0
    assert liar_in_flight(PLAN).faults[0].start_s == 5.0
    assert cut(QUICK).scenario(QUICK, 1).run.duration_s == pytest.approx(4 * QUICK.cut_s)


# ---- what is measured


def tables_of(pos_ned_m, *, own_ned_m=None, collisions_us=(), sessions=40):
    """Make tables of 50 rows per second from 1 s on; channel busy 10 %, hosts lose 3 of 12 beacons."""
    instants, vehicles = pos_ned_m.shape[:2]
    time_us = 1_000_000 + 20_000 * np.arange(instants)
    return FlightTables(
        flown=Flight(
            time_us=time_us,
            alive=np.ones((instants, vehicles), dtype=bool),
            pos_ned_m=pos_ned_m,
            q_ned_frd=np.tile((1.0, 0.0, 0.0, 0.0), (instants, vehicles, 1)),
            desired_pos_ned_m=np.broadcast_to(PLACES_NED_M, pos_ned_m.shape),
            heading_rad=np.zeros(instants),
            believed_pos_ned_m=pos_ned_m.copy() if own_ned_m is None else own_ned_m,
        ),
        air_us=time_us,
        busy_ns=time_us * 100,
        session_us=np.linspace(time_us[0], time_us[-1], sessions).astype(np.int64),
        session_ok=np.arange(sessions) % 4 > 0,
        session_by=np.arange(sessions) % vehicles,
        session_error_m=np.where(np.arange(sessions) % vehicles == 5, 5.0, 0.0),
        collisions_us=tuple(collisions_us),
        beacons_received=12,
        beacons_lost=3,
    )


def test_gains_with_feeds_for_estimates():
    """All estimates are off by the same 3 m, which shifts all phases equally: the gain is ideal.

    One estimate is missing in the first of five seconds, for which there is no gain.
    """
    scenario = BASE.scenario(PLAN, 1)
    antenna = msgspec.structs.replace(scenario.antenna, feeds_for="estimates")
    scenario = msgspec.structs.replace(scenario, antenna=antenna)
    pos_ned_m = np.tile(PLACES_NED_M, (250, 1, 1))
    own_ned_m = pos_ned_m + np.array((3.0, 3.0, 0.0))
    own_ned_m[:50, 0] = np.nan
    tables = tables_of(pos_ned_m, own_ned_m=own_ned_m)
    measures = measure(tables, scenario, formed_us=1_000_000, wall_s=2.0, gains=True)
    assert measures.gain_dbi == pytest.approx([13.262] * 4, abs=0.001)


def test_errors_of_a_flight_are_separated():
    """The estimated positions are the desired ones: the whole error is that of the estimates.

    The formation is also shifted and turned, which is an absolute error but no shape error.
    """
    rng = np.random.default_rng(8)
    turn = np.array(((math.cos(0.1), -math.sin(0.1)), (math.sin(0.1), math.cos(0.1))))
    pos_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    pos_ned_m[..., :2] = pos_ned_m[..., :2] @ turn.T + (3.0, 4.0)
    wrong_m = rng.normal(0.0, 0.2, (500, 8, 2))
    pos_ned_m[..., :2] += wrong_m
    own_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    own_ned_m[:50, 0] = np.nan  # unknown at first
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
    assert measures.beacons_lost_fraction == 0.25
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


def test_measures_end_at_a_contact_or_fall():
    """One is out of its place in one row of 150; two touch 4 s after the formation, and one falls 2 s later.

    Measures end with the contact, or with the fall if there is no contact: two of 300 rows are off then.
    Their rms is that of the error after alignment. Vehicles on the ground are excluded from distances.
    """
    pos_ned_m = np.tile(PLACES_NED_M, (500, 1, 1))
    hit = 50 + 200
    pos_ned_m[hit, 1] = pos_ned_m[hit, 0] + (0.3, 0.4, 0.0)
    pos_ned_m[hit - 20, 1, 0] += 1.5
    pos_ned_m[hit + 100 :, 1] = (50.0, 50.0, -0.1)
    pos_ned_m[hit + 100 :, 2] = (50.0, 50.1, -0.1)
    tables = tables_of(pos_ned_m, collisions_us=[1_000_000 + hit * 20_000])
    scenario = BASE.scenario(PLAN, 1)
    measures = measure(tables, scenario, formed_us=2_000_000, wall_s=0.0, gains=False)
    out_m, touch_m = shape_over_time_m(
        (pos_ned_m - PLACES_NED_M)[[hit - 20, hit], :, :2], PLACES_NED_M
    ).tolist()
    assert measures.shape_m == pytest.approx(out_m / math.sqrt(200))
    untouched = measure(tables_of(pos_ned_m), scenario, formed_us=2_000_000, wall_s=0.0, gains=False)
    assert untouched.shape_m == pytest.approx(math.hypot(out_m, touch_m) / math.sqrt(300))
    before = measure(
        tables_of(pos_ned_m, collisions_us=[1_500_000]),
        scenario,
        formed_us=2_000_000,
        wall_s=0.0,
        gains=False,
    )
    assert before.shape_m == untouched.shape_m  # a contact before the formation has no effect
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
    """(T,) shape error: the last valid one of ``(from_s, error_m)``."""
    time_s = TRACK_PERIOD_S * np.arange(round(seconds / TRACK_PERIOD_S))
    values = np.zeros(len(time_s))
    for from_s, error_m in changes:
        values[time_s >= from_s - 1e-9] = error_m
    return values


def test_recovery_requires_a_lasting_small_error():
    """0.2 m before and 1 m during; back at 0.2 m 2.4 s after the return, with a relapse before that.

    The rms of the last second is below 0.25 m when as many of its five squares are small, so 4 (0.2)^2 +
    1^2 is too large and all five must be small: 0.8 s after the first.
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
    assert (result.left, never.left) == (True, True)
    assert result.largest_during_m == pytest.approx(1.0)
    assert result.largest_after_m == pytest.approx(1.0)
    blow = judge_cut(
        shape_series(40.0, [(0, 0.2), (25, 2.0), (25.4, 0.2)]), cut_at_s=10.0, cut_s=10.0
    )  # two of five
    assert blow.largest_during_m == pytest.approx(0.2)
    assert blow.largest_after_m == pytest.approx(math.sqrt((2 * 2.0**2 + 3 * 0.2**2) / 5))
    assert (blow.left, blow.recovery_s) == (True, 0.0)
    unharmed = judge_cut(shape_series(40.0, [(0, 0.2)]), cut_at_s=10.0, cut_s=10.0)
    assert (unharmed.recovery_s, unharmed.left) == (0.0, False)
    ended = judge_cut(shape_series(4.0, [(0, 0.2)]), cut_at_s=10.0, cut_s=10.0)
    assert math.isinf(ended.recovery_s)
    assert math.isnan(ended.largest_after_m)


def test_recovery_limit_is_relative_to_the_error_before():
    shape_m = shape_series(40.0, [(0, 0.5), (12, 1.0), (25.0, 0.59)])
    assert judge_cut(shape_m, cut_at_s=10.0, cut_s=10.0).recovery_s == pytest.approx(5.0 + 0.8)
    shape_m = shape_series(40.0, [(0, 0.5), (12, 1.0), (25.0, 0.61)])
    assert math.isinf(judge_cut(shape_m, cut_at_s=10.0, cut_s=10.0).recovery_s)


def test_pull_is_the_difference_of_two_flights_of_a_seed():
    """From 10 s on one of the others is 0.4 m off, the biased UAV 9 m, and all are shifted by 2 m.

    Alignment distributes the 0.4 m: the mean of the seven removes a seventh, and the rotation removes a
    little more, which depends on the place of the vehicle.
    """
    rng = np.random.default_rng(9)
    usual_ne_m = rng.normal(0.0, 0.1, (150, 8, 2))
    biased_ne_m = usual_ne_m.copy()
    biased_ne_m[50:] += (2.0, 0.0)
    biased_ne_m[50:, LIAR] += 9.0
    biased_ne_m[50:, 0, 0] += 0.4
    pull = judge_liar(biased_ne_m, usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=5.0)
    assert 0.5 * 0.4 < pull.displacement_m < 0.4 * 6 / 7 + 0.02
    assert pull.lasting_m == pytest.approx(pull.displacement_m * 100 / 125, rel=0.1)
    assert pull.shift_m == pytest.approx(2.0 + 0.4 / 7, rel=1e-6)
    assert pull.moved_m == pytest.approx(2.4, rel=1e-6)
    assert pull.shape_m > pull.shape_without_m
    same = judge_liar(usual_ne_m, usual_ne_m[:120], PLACES_NED_M, liar=LIAR, from_s=5.0)
    assert same.displacement_m == same.shift_m == 0.0
    short = judge_liar(biased_ne_m[:51], usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=10.0)
    assert short.shift_m > 1.9
    ended = judge_liar(biased_ne_m[:50], usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=10.0)
    assert all(math.isnan(getattr(ended, name)) for name in ended.__struct_fields__)


def test_rotation_displaces_in_space_but_not_in_the_shape():
    """All rotate by 2 degrees about the origin: the farthest other, at r, moves by 2 r sin(1 degree)."""
    usual_ne_m = np.zeros((150, 8, 2))
    angle = math.radians(2.0)
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    turned_ne_m = usual_ne_m.copy()
    turned_ne_m[50:] = PLACES_NED_M[:, :2] @ turn.T - PLACES_NED_M[:, :2]
    pull = judge_liar(turned_ne_m, usual_ne_m, PLACES_NED_M, liar=LIAR, from_s=5.0)
    others = [i for i in range(8) if i != LIAR]
    farthest_m = np.linalg.norm(PLACES_NED_M[others, :2], axis=1).max()
    assert pull.turn_deg == pytest.approx(2.0)
    assert pull.moved_m == pytest.approx(2.0 * farthest_m * math.sin(angle / 2))
    assert pull.displacement_m == pytest.approx(0.0, abs=1e-9)

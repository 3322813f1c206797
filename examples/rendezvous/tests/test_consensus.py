"""The law by itself: limit of the gain, time of convergence, lost beacons, distances."""

import math

import numpy as np
import pytest
from rendezvous.application import Settings
from rendezvous.beacon import Beacon, decode
from rendezvous.consensus import meeting_time_s, offsets_m, spread_m, velocity_m_s

SPEED_M_S = 3.0
GAIN_1_S = 0.4


def points(rng, count, size_m=100.0):
    return [tuple(point) for point in rng.uniform(-size_m, size_m, (count, 2)).tolist()]


def advance(states, seen, gain_1_s, speed_m_s, period_s):
    """Return the states after one period; ``seen[i]`` has those that UAV i has received."""
    moves = [velocity_m_s(states[i], seen[i], gain_1_s, speed_m_s) for i in range(len(states))]
    return [
        (n + period_s * v_n, e + period_s * v_e) for (n, e), (v_n, v_e) in zip(states, moves, strict=True)
    ]


def others(states):
    return [states[:i] + states[i + 1 :] for i in range(len(states))]


@pytest.mark.parametrize("count", [2, 5, 12])
def test_the_spread_falls_within_the_derived_time(count):
    rng, period_s, end_m = np.random.default_rng(count), 0.04, 0.5
    for _ in range(20):
        states = points(rng, count)
        bound_s = meeting_time_s(spread_m(states), end_m, GAIN_1_S, SPEED_M_S)
        for _ in range(math.ceil(bound_s / period_s)):
            states = advance(states, others(states), GAIN_1_S, SPEED_M_S, period_s)
        assert spread_m(states) <= end_m


def test_no_uav_is_faster_than_the_limit():
    rng = np.random.default_rng(1)
    for _ in range(200):
        own, *rest = points(rng, 4, size_m=10.0 ** rng.uniform(-3, 4))
        assert math.hypot(*velocity_m_s(own, rest, GAIN_1_S, SPEED_M_S)) <= SPEED_M_S * (1.0 + 1e-12)


def test_below_the_limit_of_the_gain_states_converge_and_above_twice_the_limit_they_diverge():
    rng = np.random.default_rng(2)
    for count in range(2, 9):
        begin = points(rng, count)
        for product, converges in ((0.99, True), (2.1, False)):
            states = begin
            for _ in range(60):
                states = advance(states, others(states), product / 0.2, math.inf, 0.2)
            assert (spread_m(states) < 1e-6) is converges
            assert (spread_m(states) > spread_m(begin)) is not converges


def test_with_half_of_the_beacons_lost_they_meet_still():
    rng, period_s = np.random.default_rng(3), 0.2
    states = points(rng, 5)
    last = others(states)
    for _ in range(500):
        now = others(states)
        last = [
            [new if rng.random() < 0.5 else old for new, old in zip(news, olds, strict=True)]
            for news, olds in zip(now, last, strict=True)
        ]
        states = advance(states, last, GAIN_1_S, SPEED_M_S, period_s)
    assert spread_m(states) < 0.1


def test_nobody_comes_nearer_than_the_spacing_on_the_way():
    rng, spacing_m = np.random.default_rng(4), 10.0
    for _ in range(30):
        places = points(rng, 6)
        offsets = offsets_m(places, spacing_m)
        least_m = min(math.dist(a, b) for i, a in enumerate(offsets) for b in offsets[:i])
        assert least_m <= spacing_m * (1.0 + 1e-9)
        states = [(p[0] - d[0], p[1] - d[1]) for p, d in zip(places, offsets, strict=True)]
        nearest_m = math.inf
        for _ in range(1_500):
            states = advance(states, others(states), GAIN_1_S, SPEED_M_S, 0.04)
            at = [(z[0] + d[0], z[1] + d[1]) for z, d in zip(states, offsets, strict=True)]
            nearest_m = min(nearest_m, *(math.dist(a, b) for i, a in enumerate(at) for b in at[:i]))
        assert nearest_m == pytest.approx(least_m, abs=0.01)


def test_places_above_each_other_are_refused():
    with pytest.raises(ValueError, match="side by side"):
        offsets_m([(0.0, 0.0), (0.0, 0.0)], 5.0)


def test_a_beacon_is_decoded_as_it_was_encoded_and_other_bytes_are_none():
    beacon = Beacon(1_234_567, 1.5, -2.25, 0.5, -0.25)
    assert decode(beacon.encode()) == beacon
    assert beacon.at(2_234_567) == (2.0, -2.5)
    payload = beacon.encode()
    wrong = (
        b"",
        payload[:-1],
        payload + b"x",
        b"X" + payload[1:],
        Beacon(0, math.nan, 0.0, 0.0, 0.0).encode(),
    )
    assert [decode(each) for each in wrong] == [None] * len(wrong)


@pytest.mark.parametrize(
    ("field", "settings"),
    [
        ("gain_1_s", {"gain_1_s": 1.0, "beacon_period_ms": 1_000}),
        ("forget_after_s", {"forget_after_s": 0.2, "beacon_period_ms": 200}),
    ],
)
def test_settings_that_do_not_converge_are_refused(field, settings):
    with pytest.raises(ValueError, match=f"^{field}: .*expected"):
        Settings(**settings)

"""What is drawn about a link: shadowing by place, fading and blockage by time. About 3 s."""

from math import exp, pi

import numpy as np
import pytest
from netsim_swarm import make_links
from scipy.special import j0

from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS
from netsim.model.random_streams import RandomStreams
from netsim.phy.fading import SECTORS, RicianFading, _turn, gain
from netsim.phy.obstruction import KEPT_NS, Obstruction
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S
from netsim.phy.propagation import ROW_LIFETIME_NS, Trajectories, _power_law
from netsim.phy.shadowing import LogNormalShadowing

SECOND_NS = 1_000_000_000
REST = (0.0, 0.0, 0.0)


def streams(seed=5):
    return RandomStreams(np.random.SeedSequence(seed))


# --- shadowing


def shadowing_db(field, places):
    return field.gain_db(places, places, np.linalg.norm(places - places[:, None], axis=2))


def shadowing_of(places, links, *, seeds=2_500, std_db=4.0):
    """(seeds, links) in dB of the links (end, end) between the places, each seed with a field of its own."""
    places, ends = np.array(places), tuple(zip(*links, strict=True))
    fields = (LogNormalShadowing(std_db, 20.0, streams(seed)) for seed in range(seeds))
    return np.array([shadowing_db(field, places)[ends] for field in fields])


def test_shadowing_has_its_deviation_and_gudmundsons_correlation():
    """Over 2500 fields a deviation's standard error is 1.4 %, a correlation's 0.02 (1 - r^2)."""
    a, b = (0.0, 0.0, -30.0), (200.0, 0.0, -30.0)
    a_20, b_10, b_up = (0.0, 20.0, -30.0), (210.0, 0.0, -30.0), (200.0, 0.0, -90.0)
    near = (3.0, 0.0, -30.0)
    places = [a, b, a_20, b_10, b_up, near]
    values = shadowing_of(places, [(0, 1), (2, 1), (0, 3), (0, 4), (2, 3), (0, 5)])
    assert values.mean(axis=0) == pytest.approx(np.zeros(6), abs=4.0 * 4.0 / 50.0)
    # of the link over 3 m as well, whose two directions are almost the same field
    assert values.std(axis=0) == pytest.approx(np.full(6, 4.0), rel=0.06)
    # a normal distribution has 4.55 % beyond two deviations
    assert np.mean(np.abs(values[:, 0]) > 8.0) == pytest.approx(0.0455, abs=0.013)
    correlation = np.corrcoef(values.T)[0]
    assert correlation[1] == pytest.approx(exp(-1.0), abs=0.06)  # one end has moved by 20 m
    assert correlation[2] == pytest.approx(exp(-0.5), abs=0.06)  # the other by 10 m
    assert correlation[3] == pytest.approx(exp(-3.0), abs=0.06)  # or upwards by 60 m
    assert correlation[4] == pytest.approx(exp(-1.5), abs=0.06)  # both


def test_shadowing_is_reciprocal_and_a_function_of_position():
    rng = np.random.default_rng(2)
    places = rng.uniform(-100.0, 100.0, (10, 3))
    field = LogNormalShadowing(4.0, 20.0, streams())
    matrix_db = shadowing_db(field, places)
    assert matrix_db == pytest.approx(matrix_db.T, abs=1e-9)
    # independent of the station, and of whether it is an interferer
    order = rng.permutation(10)
    assert shadowing_db(field, places[order]) == pytest.approx(matrix_db[np.ix_(order, order)], abs=1e-9)
    apart = np.linalg.norm(places[3:] - places[:3, None], axis=2)
    assert field.gain_db(places[:3], places[3:], apart) == pytest.approx(matrix_db[:3, 3:], abs=1e-9)


def links_of(places, velocities, **settings):
    config = RadioConfig(**settings)
    trajectories = Trajectories(len(places))
    links = make_links(config, trajectories, len(places), seed=5)
    trajectories.set(0, places, velocities)
    return links, trajectories


def test_shadowing_of_a_moving_link_does_not_depend_on_the_query_order():
    places, velocities = [REST, (60.0, 0.0, 0.0), (0.0, 50.0, 0.0)], [REST, (0.0, 20.0, 0.0), REST]
    settings = {"rician_k_db": None, "shadowing_std_db": 6.0}
    asked_often, _ = links_of(places, velocities, **settings)
    for at_ns in range(0, SECOND_NS, 1_300_000):
        asked_often.row(2, at_ns)
    at_ns = 250 * ROW_LIFETIME_NS
    asked_once, _ = links_of(places, velocities, **settings)
    assert asked_often.row(1, at_ns).powers_mw.tolist() == asked_once.row(1, at_ns).powers_mw.tolist()
    there = [REST, (60.0, 20.0, 0.0), (0.0, 50.0, 0.0)]
    standing, _ = links_of(there, [REST] * 3, **settings)
    assert standing.row(1, 0).powers_mw == pytest.approx(asked_once.row(1, at_ns).powers_mw)


# --- fading


def fading(k_db=3.0, doppler_hz=5.0, stations=2, seed=5):
    return RicianFading(
        k_db=k_db, doppler_hz=doppler_hz, frequency_mhz=5210.0, stations=stations, streams=streams(seed)
    )


def gains(model, source, at_ns):
    """Power gains (n,) of the links of a station."""
    stations = len(model._theta_rad)
    return np.array([gain(model.block, stations, source, receiver, at_ns) for receiver in range(stations)])


def gains_of_pairs(model, stations, times_ns):
    """Of all pairs, (times, pairs)."""
    pairs = np.triu_indices(stations, 1)
    return np.array([np.array([gains(model, i, t) for i in range(stations)])[pairs] for t in times_ns])


@pytest.mark.parametrize("k_db", [-20.0, 0.0, 12.0])
def test_gains_have_mean_one_and_the_variance_of_their_k(k_db):
    """Of N sines with equal amplitude the scattered power has the variance 1 - 1 / N, not 1.

    780 links at 30 times, of which each link's are correlated somewhat: standard error 1.5 % at most.
    """
    powers = gains_of_pairs(fading(k_db, 50.0, 40), 40, range(0, SECOND_NS, SECOND_NS // 30))
    k = 10 ** (k_db / 10)
    assert powers.mean() == pytest.approx(1.0, abs=0.015)
    variance = (2 * k + 1 - 1 / (2 * SECTORS)) / (k + 1) ** 2
    assert powers.var() == pytest.approx(variance, rel=0.06)


def test_gains_are_correlated_in_time_by_clarkes_bessel_function():
    """With a strong steady ray a gain is 1 + 2 Re(s) sigma, so that its correlation is that of s, J0.

    Over 780 links and 20 times the standard error is under 0.02.
    """
    doppler_hz, stations = 40.0, 40
    model = fading(30.0, doppler_hz, stations)
    starts_ns = range(0, 4 * SECOND_NS, SECOND_NS // 5)
    first = gains_of_pairs(model, stations, starts_ns)
    for tau_s in (0.001, 0.003, 0.00957, 0.0152, 0.0279):
        later = gains_of_pairs(model, stations, [t + round(tau_s * 1e9) for t in starts_ns])
        measured = np.corrcoef(first.ravel(), later.ravel())[0, 1]
        assert measured == pytest.approx(j0(2 * pi * doppler_hz * tau_s), abs=0.04)


def test_links_fade_independently_of_each_other():
    times_ns = np.random.default_rng(1).integers(0, 1_000 * SECOND_NS, 1_000).tolist()
    correlation = np.corrcoef(gains_of_pairs(fading(0.0, 50.0, 12), 12, times_ns).T) - np.eye(66)
    # standard error 0.032; of 2145 the largest is under 5 of them
    assert np.abs(correlation).max() < 0.16


def test_fading_is_reciprocal_and_independent_of_queries_and_stations():
    few, many = fading(stations=3), fading(stations=9)
    for t in range(0, SECOND_NS, SECOND_NS // 7):
        gains(many, 8, t)
        assert gains(many, 2, t + 5)[:2].tolist() == gains(few, 2, t + 5)[:2].tolist()
    assert gains(many, 0, 77)[1] == gains(many, 1, 77)[0]
    assert gains(many, 0, 77)[1:3].tolist() == gains(few, 0, 77)[1:].tolist()
    assert gains(fading(seed=6), 0, 0)[1] != gains(fading(seed=5), 0, 0)[1]


def test_motion_fades_with_its_doppler_spread():
    """Speed / wavelength and the spread at rest add by squares: for 0.5 s at one speed, 0.3 s at another.

    The same phase is reached by stations at rest with the mean spread of that time.
    """
    wavelength_m = SPEED_OF_LIGHT_M_S / 5.21e9
    moving = fading(doppler_hz=30.0)
    moving.move(0, np.array([REST, REST]), np.array([(3.0, 0.0, 0.0), REST]))
    there = [(1.5, 0.0, 0.0), REST]
    moving.move(SECOND_NS // 2, np.array(there), np.array([(3.0, 4.0, 0.0), (3.0, 4.0, -7.0)]))
    gains(moving, 1, 600_000_000)
    turns = 0.5 * np.hypot(30.0, 3.0 / wavelength_m) + 0.3 * np.hypot(30.0, 7.0 / wavelength_m)
    resting = fading(doppler_hz=turns / 0.8)
    expected = gains(resting, 0, 800_000_000)[1]
    assert gains(moving, 0, 800_000_000)[1] == pytest.approx(expected, rel=1e-9)
    assert gains(moving, 0, 500_000_000)[1] != pytest.approx(expected, rel=1e-3)


def test_fading_does_not_depend_on_the_update_rate():
    """2 s with a speed of 3 + 2 sin(12.5 t) m/s, stated every 4 ms or once in 2 s.

    What remains are the squares of the spread at rest: 5 Hz beside 17 to 87 Hz.
    """
    often, seldom, times_s = fading(k_db=0.0), fading(k_db=0.0), np.arange(0.0, 2.0001, 0.004)
    for time_s in times_s.tolist():
        way_m = 3.0 * time_s + 0.16 * (1.0 - np.cos(12.5 * time_s))
        velocities = [REST, (0.0, 3.0 + 2.0 * np.sin(12.5 * time_s), 0.0)]
        stated = np.array([REST, (way_m, 0.0, 0.0)]), np.array(velocities)
        often.move(round(1e9 * time_s), *stated)
        if time_s in (0.0, 2.0):
            seldom.move(round(1e9 * time_s), *stated)
    turns = [model._theta_rad[0, 1] / (2.0 * pi) for model in (often, seldom)]
    # the mean of sqrt(f^2 + 25 Hz^2) over that speed, by itself
    speeds_hz = (3.0 + 2.0 * np.sin(12.5 * times_s)) / SPEED_OF_LIGHT_M_S * 5.21e9
    excess = 2.0 * np.mean(np.hypot(speeds_hz, 5.0) - speeds_hz)
    assert turns[0] - turns[1] == pytest.approx(excess - 2.0 * (np.hypot(52.13, 5.0) - 52.13), abs=0.25)


def test_channel_without_stations_is_valid():
    fading(stations=0).move(0, np.empty((0, 3)), np.empty((0, 3)))


def test_channel_without_doppler_is_constant_at_rest():
    model = fading(doppler_hz=0.0, stations=3)
    before = gains(model, 0, 0)
    assert gains(model, 0, 100 * SECOND_NS).tolist() == before.tolist()
    # stations with equal velocities have no relative motion
    velocities = np.array([(9.0, 0.0, 0.0), (9.0, 0.0, 0.0), REST])
    model.move(100 * SECOND_NS, np.array([REST] * 3), velocities)
    after = gains(model, 0, 101 * SECOND_NS)
    assert after[1] == before[1]
    assert after[2] != before[2]


def test_a_links_fading_follows_the_vehicles_velocities():
    links, trajectories = links_of([REST] * 2, [REST] * 2, fading_doppler_hz=0.0)
    before = gains(links.fading, 0, SECOND_NS)[1]
    assert gains(links.fading, 0, 0)[1] == before
    trajectories.set(SECOND_NS, [REST] * 2, [REST, (5.0, 0.0, 0.0)])
    assert gains(links.fading, 0, SECOND_NS)[1] == before
    assert gains(links.fading, 0, SECOND_NS + 50_000_000)[1] != before


# --- blockage


def obstruction(fraction, duration_s=2.0, stations=2, seed=5):
    return Obstruction(fraction=fraction, duration_s=duration_s, stations=stations, streams=streams(seed))


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.8])
def test_blockage_has_the_configured_fraction_and_mean_duration(fraction):
    """435 links over 60 s with spells of 0.5 s: some 10^4 spells at a share of 0.1, more above it.

    At time 0 as later: the process is stationary from the start, within 4 standard errors of 0.024.
    """
    stations = 30
    model = obstruction(fraction, 0.5, stations)
    spells_ns, shares, at_start = [], [], []
    for a in range(stations):
        for b in range(a):
            at_start.append(model.blocked(a, b, 0)[0])
            at_ns, blocked_ns = 0, 0
            while at_ns < 60 * SECOND_NS:
                blocked, until_ns = model.blocked(a, b, at_ns)
                if blocked:
                    blocked_ns += min(until_ns, 60 * SECOND_NS) - at_ns
                    if at_ns > 0:
                        spells_ns.append(until_ns - at_ns)
                at_ns = until_ns
            shares.append(blocked_ns / (60 * SECOND_NS))
    assert np.mean(shares) == pytest.approx(fraction, rel=0.06)
    assert np.mean(spells_ns) == pytest.approx(SECOND_NS / 2, rel=0.06)
    assert np.std(spells_ns) == pytest.approx(SECOND_NS / 2, rel=0.08)
    assert np.mean(at_start) == pytest.approx(fraction, abs=0.1)


def test_blockage_is_reciprocal_and_independent_of_the_query_order():
    ahead, back = obstruction(0.4, stations=4), obstruction(0.4, stations=7)
    # whole groups of times within what is kept are asked backwards
    times_ns = [group + step for group in range(0, 60 * SECOND_NS, SECOND_NS) for step in (0, KEPT_NS // 2)]
    states = {(t, i, j): ahead.blocked(i, j, t) for t in times_ns for i in range(4) for j in range(i)}
    assert len(times_ns) == 120
    for second in range(60):
        group = [key for key in states if key[0] // SECOND_NS == second]
        for t, i, j in reversed(group):
            assert back.blocked(j, i, t) == states[t, i, j]
    assert len({blocked for blocked, _ in states.values()}) == 2


def test_old_switches_are_removed_without_effect():
    """An hour of 10 ms: 180 000 switches, of which those of the last 100 ms are kept, 10 on average."""
    often, once = obstruction(0.5, 0.01), obstruction(0.5, 0.01)
    for at_ns in range(0, 60 * SECOND_NS, 700_000):
        state = often.blocked(0, 1, at_ns)
    assert once.blocked(0, 1, at_ns) == state
    for before_ns in range(0, KEPT_NS, 1_000_000):
        assert once.blocked(0, 1, at_ns - before_ns) == often.blocked(0, 1, at_ns - before_ns)
    once.blocked(0, 1, 3_600 * SECOND_NS)
    assert len(once._pairs[0, 1].switches_ns) < 100


def test_fractions_of_0_and_1_are_exact():
    assert obstruction(0.0).blocked(0, 1, 10**15) == (False, NEVER_NS)
    assert obstruction(1.0).blocked(0, 1, 10**15) == (True, NEVER_NS)
    assert obstruction(1e-300).blocked(0, 1, 10**15)[0] is False


def test_a_blocked_link_loses_power_as_long_as_it_is_blocked():
    places = [REST, (10.0, 0.0, 0.0), (0.0, 30.0, 0.0)]
    clear_mw = links_of(places, [REST] * 3, rician_k_db=None)[0].row(0, 0).powers_mw
    links, _ = links_of(
        places, [REST] * 3, rician_k_db=None, nlos_fraction=0.5, nlos_duration_s=0.05, nlos_loss_db=12.0
    )
    seen = set()
    for at_ns in range(0, 2 * SECOND_NS, 3_000_000):
        row = links.row(0, at_ns)
        for r in (1, 2):
            blocked = links.blocked(r, 0, at_ns)
            seen.add((r, blocked))
            assert row.powers_mw[r] == pytest.approx(clear_mw[r] / (10**1.2 if blocked else 1.0))
    assert len(seen) == 4
    never, _ = links_of(places, [REST] * 3)
    assert not never.blocked(0, 1, 0)


def test_budgets_and_fading_are_bit_identical_without_the_compiler():
    """Compiled code and Python round alike, so that a run is the same with NUMBA_DISABLE_JIT=1."""
    rng = np.random.default_rng(7)
    count = 6

    def budget(kernel, motion, source):
        powers_mw, distances_m = np.empty(count), np.empty(count)
        delays_ns = np.empty(count, np.int64)
        longest_ns = kernel(
            *motion, 0.0123, source, 1.7e-4, 2.0, 4_796.7, 1e-12, powers_mw, distances_m, delays_ns
        )
        return longest_ns, powers_mw.tobytes(), distances_m.tobytes(), delays_ns.tobytes()

    def turned(kernel, motion):
        theta_rad, rates_rad_ns = np.zeros((count, count)), np.zeros((count, count))
        kernel(theta_rad, rates_rad_ns, motion[0], motion[0] + motion[1], motion[1], 0.004, 5.0, 0.0575)
        return theta_rad.tobytes(), rates_rad_ns.tobytes()

    for _ in range(1_000):
        motion = 30.0 * rng.normal(size=(count, 3)), rng.normal(size=(count, 3))
        source = int(rng.integers(count))
        plain = getattr(_power_law, "py_func", _power_law), getattr(_turn, "py_func", _turn)
        assert budget(_power_law, motion, source) == budget(plain[0], motion, source)
        assert turned(_turn, motion) == turned(plain[1], motion)

"""Durations, rates, packet errors, link budget, capture and the reasons of losses."""

from math import log

import numpy as np
import pytest
from netsim_air import A, Air, B, C

from netsim.config import RadioConfig
from netsim.phy.errors import coded_bit_error_rate, error_model, packet_error_rate
from netsim.phy.modes import phy_mode, response_mode
from netsim.phy.propagation import Links, RicianFading, Trajectories, friis_loss_db, thermal_noise_mw
from netsim.streams import Streams

ALL_MODES = [f"ofdm{rate}" for rate in (6, 9, 12, 18, 24, 36, 48, 54)] + [f"vht_mcs{i}" for i in range(10)]


@pytest.mark.parametrize(
    ("mode", "rts_us", "short_us"), [("ofdm6", 52, 44), ("ofdm12", 36, 32), ("ofdm24", 28, 28)]
)
def test_control_frames_last_as_in_the_standard(mode, rts_us, short_us):
    assert phy_mode(mode, 20).duration_ns(20) == 1_000 * rts_us
    assert phy_mode(mode, 20).duration_ns(14) == 1_000 * short_us


def test_data_frames_last_preamble_and_whole_symbols():
    # 364 bytes at 6 Mbit/s: 20 + 4 ceil(2934 / 24)
    assert phy_mode("ofdm6", 20).duration_ns(364) == 512_000
    # VHT at 80 MHz, MCS 0: 40 + 4 ceil((22 + 8 * 52) / 117) with the delimiter's 4 bytes
    assert phy_mode("vht_mcs0", 80).duration_ns(48) == 56_000
    # a symbol more for one bit more: 21 bytes are 190 bits in 8 symbols of 24, 22 bytes are 198 in 9
    assert phy_mode("ofdm6", 20).duration_ns(21) + 4_000 == phy_mode("ofdm6", 20).duration_ns(22)


@pytest.mark.parametrize(
    ("width", "rates"),
    [
        (20, [6.5, 13, 19.5, 26, 39, 52, 58.5, 65, 78]),
        (40, [13.5, 27, 40.5, 54, 81, 108, 121.5, 135, 162, 180]),
        (80, [29.25, 58.5, 87.75, 117, 175.5, 234, 263.25, 292.5, 351, 390]),
    ],
)
def test_vht_rates(width, rates):
    assert [phy_mode(f"vht_mcs{i}", width).bits_per_symbol / 4 for i in range(len(rates))] == rates


def test_vht_mcs_9_does_not_exist_at_20_mhz():
    with pytest.raises(ValueError, match="MCS 9"):
        phy_mode("vht_mcs9", 20)


def test_answers_go_at_the_highest_mandatory_rate_not_above_the_frames():
    answers = {mode: response_mode(phy_mode(mode, 80)).name for mode in ALL_MODES}
    assert {mode for mode, answer in answers.items() if answer == "ofdm6"} == {"ofdm6", "ofdm9", "vht_mcs0"}
    assert {mode for mode, answer in answers.items() if answer == "ofdm12"} == {
        "ofdm12",
        "ofdm18",
        "vht_mcs1",
        "vht_mcs2",
    }
    assert answers["ofdm24"] == answers["ofdm54"] == answers["vht_mcs9"] == "ofdm24"


def snr_db_at_a_tenth(mode, frame_bytes):
    low_db, high_db = -5.0, 40.0
    while high_db - low_db > 1e-3:
        middle_db = (low_db + high_db) / 2
        if packet_error_rate(mode, frame_bytes, 10 ** (middle_db / 10)) > 0.1:
            low_db = middle_db
        else:
            high_db = middle_db
    return low_db


# two points of ns-3 3.37's NIST model around a packet error rate of 0.1, log-linear between them
@pytest.mark.parametrize(
    ("mode", "frame_bytes", "below", "above"),
    [
        ("ofdm6", 100, (3.0, 0.177535), (3.5, 0.0347475)),
        ("ofdm12", 300, (6.5, 0.1041), (7.0, 0.0188018)),
        ("ofdm18", 1458, (9.5, 0.291396), (10.0, 0.062516)),
        ("ofdm24", 1458, (13.0, 0.401471), (13.5, 0.0991888)),
        ("ofdm48", 1458, (21.0, 0.270054), (21.5, 0.0624013)),
        ("ofdm54", 100, (21.5, 0.173169), (22.0, 0.0435472)),
    ],
)
def test_packet_errors_of_non_ht_are_the_nist_models(mode, frame_bytes, below, above):
    expected_db = below[0] + (above[0] - below[0]) * log(below[1] / 0.1) / log(below[1] / above[1])
    assert snr_db_at_a_tenth(phy_mode(mode, 20), frame_bytes) == pytest.approx(expected_db, abs=0.03)


@pytest.mark.parametrize("i", range(10))
def test_soft_decisions_of_vht_gain_two_to_four_db_over_hard_ones(i):
    # the same constellation and code rate decided hard: non-HT where it exists, else the bound itself
    vht = phy_mode(f"vht_mcs{i}", 80)
    twin = {0: "ofdm6", 1: "ofdm12", 2: "ofdm18", 3: "ofdm24", 4: "ofdm36", 5: "ofdm48", 6: "ofdm54"}.get(i)
    if twin is None:
        assert snr_db_at_a_tenth(vht, 300) > snr_db_at_a_tenth(phy_mode(f"vht_mcs{i - 1}", 80), 300)
    else:
        gain_db = snr_db_at_a_tenth(phy_mode(twin, 20), 300) - snr_db_at_a_tenth(vht, 300)
        assert 2.0 < gain_db < 4.0


@pytest.mark.parametrize("name", ALL_MODES)
def test_errors_fall_with_the_ratio_and_the_table_follows_the_formula(name):
    mode = phy_mode(name, 80)
    ratios = [10 ** (db / 10) for db in np.arange(-12.0, 47.0, 0.33)]
    rates = [packet_error_rate(mode, 500, ratio) for ratio in ratios]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] == pytest.approx(1.0)
    assert rates[-1] == 0.0
    for ratio in ratios:
        exact = coded_bit_error_rate(mode, ratio)
        if 1e-12 < exact < 1e-2:
            assert error_model(mode).hazard_per_bit(ratio) == pytest.approx(exact, rel=0.02)


def test_noise_and_friis_are_the_facts_sheets():
    for width, noise_dbm in ((20, -93.99), (40, -90.98), (80, -87.97)):
        # the sheet takes 290 K; so do we
        assert 10 * np.log10(thermal_noise_mw(width, 7.0)) == pytest.approx(noise_dbm, abs=0.03)
    assert friis_loss_db(1.0, 5180.0) == pytest.approx(46.73, abs=0.01)
    assert friis_loss_db(100.0, 5180.0) == pytest.approx(86.73, abs=0.01)


REST = [(0.0, 0.0, 0.0)] * 2


def links(stations=2, **settings):
    config = RadioConfig(frequency_mhz=5180.0, rician_k_db=None, **settings)
    trajectories = Trajectories(stations)
    return Links(config, trajectories, stations, Streams(np.random.SeedSequence(5))), trajectories


def test_received_power_falls_with_the_exponent_and_follows_the_vehicles():
    budget, trajectories = links(path_loss_exponent=2.6)
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    at_10_m = budget.row(0, 0)
    assert 10 * np.log10(at_10_m.powers_mw[1]) == pytest.approx(16.0 - 46.73 - 26.0, abs=0.01)
    assert at_10_m.delays_ns == [0, 33]
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0)])
    assert trajectories.distance_m(0, 1, 500_000_000) == pytest.approx(55.0)
    assert 10 * np.log10(budget.row(0, 1_000_000_000).powers_mw[1]) == pytest.approx(
        16.0 - 46.73 - 52.0, abs=0.01
    )


def test_extra_attenuation_comes_and_goes():
    budget, trajectories = links(extra_attenuation_db=3.0)
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    configured_mw = budget.row(0, 0).powers_mw[1]
    budget.set_extra_attenuation_db(23.0)
    assert budget.row(0, 0).powers_mw[1] == pytest.approx(configured_mw / 100)
    budget.set_extra_attenuation_db(None)
    assert budget.row(0, 0).powers_mw[1] == configured_mw


def test_an_attenuation_that_does_not_change_costs_nothing():
    budget, trajectories = links()
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    budget.set_extra_attenuation_db(5.0)
    row = budget.row(0, 0)
    budget.set_extra_attenuation_db(5.0)
    assert budget.row(0, 0) is row


def test_a_budget_from_the_way_does_not_outlive_the_motion():
    budget, trajectories = links()
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (2500.0, 0.0, 0.0)])
    assert budget.row(0, 2_000_000).delays_ns[1] == 50  # 15 m half-way
    trajectories.set(4_000_000, [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0)], REST)
    assert budget.row(0, 4_000_000).delays_ns[1] == 67  # 20 m
    row = budget.row(0, 4_000_000)
    trajectories.set(8_000_000, [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0)], REST)
    assert budget.row(0, 60_000_000) is row


def test_each_links_gains_are_its_own_streams_whatever_the_other_links():
    streams = Streams(np.random.SeedSequence(5))
    few, many = RicianFading(3.0, 2, streams), RicianFading(3.0, 9, streams)
    for _ in range(2 * RicianFading.BLOCK):
        assert few.gains(0)[1] == many.gains(0)[1]


def test_shadowing_is_reciprocal_and_has_its_deviation():
    stations = 60
    budget, trajectories = links(stations, shadowing_std_db=4.0)
    trajectories.set(0, [(0.0, 0.0, 0.0)] * stations, [(0.0, 0.0, 0.0)] * stations)
    power_dbm = 10 * np.log10(
        np.array([budget.row(i, 0).powers_mw for i in range(stations)]) + np.eye(stations)
    )
    assert np.array_equal(power_dbm, power_dbm.T)
    # 1770 draws: the deviation's own standard error is 1.7 %
    assert np.std(power_dbm[np.triu_indices(stations, 1)]) == pytest.approx(4.0, rel=0.06)


def test_rician_gain_has_mean_one_and_the_variance_of_its_k():
    fading = RicianFading(3.0, 2, Streams(np.random.SeedSequence(5)))
    gains = np.array([fading.gains(0)[1] for _ in range(20_000)])
    k = 10**0.3
    variance = (2 * k + 1) / (k + 1) ** 2
    assert gains.mean() == pytest.approx(1.0, abs=4 * (variance / gains.size) ** 0.5)
    assert gains.var() == pytest.approx(variance, rel=0.05)
    assert fading.gains(1)[0] != gains[0]


@pytest.mark.parametrize(("later_us", "captured"), [(8, True), (30, False)])
def test_a_stronger_frame_takes_the_receiver_from_a_preamble_only(later_us, captured):
    # A and B do not hear each other; at C the later frame is 20 dB stronger
    hidden = {(A, B): -200.0, (B, A): -200.0, (A, C): -70.0, (B, C): -50.0}
    air = Air(3, powers_dbm=hidden)
    air.send(1000, A)
    air.send(1000 + later_us, B)
    air.run()
    from_a, from_b = air.transmissions
    assert C in from_a.collided
    assert C in (from_b.delivered if captured else from_b.collided)


def test_losses_have_the_reason_that_the_ratio_gives():
    # -91 dBm is 3 dB over the noise: no preamble is found, with or without anybody else on the air
    air = Air(3, powers_dbm={(A, C): -91.0, (A, B): -200.0, (B, A): -200.0})
    air.send(1000, A)
    air.send(1000, B)
    air.send(5000, A)
    air.run()
    assert [t.lost_to_noise for t in air.transmissions if t.source == A] == [[B, C], [B, C]]
    assert next(t for t in air.transmissions if t.source == B).delivered == [C]


def test_a_short_overlap_costs_less_than_a_long_one():
    # 24 Mbit/s 13 dB over an interferer that reaches only C: the less of it is hit, the likelier it lives
    survived = []
    for interferer_bytes in (1, 30, 400):
        hidden = {(A, B): -200.0, (B, A): -200.0, (A, C): -60.0, (B, C): -73.2}
        count = 0
        for seed in range(60):
            air = Air(3, powers_dbm=hidden, seed=seed)
            air.send(1000, A, mode="ofdm24", frame_bytes=1500)
            air.send(1100, B, mode="ofdm24", frame_bytes=interferer_bytes)
            air.run()
            count += C in next(t for t in air.transmissions if t.source == A).delivered
        survived.append(count)
    assert survived[0] > survived[1] > survived[2]


def test_energy_of_several_weak_signals_adds_up():
    # -64 dBm each is under the threshold of -62, two together are over it; neither is found as a preamble
    air = Air(4, powers_dbm={(A, C): -64.0, (B, C): -64.0}, backoffs={C: [(0, 15)]})
    air.send(1000, A)
    air.send(1000, B, frame_bytes=200)
    air.send(1100, C)
    # A ends at 1160, after which B's -64 dBm alone do not hold C back
    assert next(frame for frame in air.run() if frame[2] == C)[0] == 1160 + 34

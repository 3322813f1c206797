"""Durations, rates, link budget, capture and the reasons of losses."""

import msgspec
import numpy as np
import pytest
from netsim_air import A, Air, B, C
from netsim_swarm import make_links

from netsim.model.config import RadioConfig
from netsim.phy.modes import phy_mode, response_mode
from netsim.phy.path_loss import friis_loss_db
from netsim.phy.propagation import Trajectories, thermal_noise_mw

ALL_MODES = [f"ofdm{rate}" for rate in (6, 9, 12, 18, 24, 36, 48, 54)] + [f"vht_mcs{i}" for i in range(10)]


@pytest.mark.parametrize(
    ("mode", "rts_us", "short_us"), [("ofdm6", 52, 44), ("ofdm12", 36, 32), ("ofdm24", 28, 28)]
)
def test_control_frame_durations_match_the_standard(mode, rts_us, short_us):
    assert phy_mode(mode, 20).duration_ns(20) == 1_000 * rts_us
    assert phy_mode(mode, 20).duration_ns(14) == 1_000 * short_us


def test_data_frame_durations_are_preamble_and_whole_symbols():
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


def test_responses_use_the_highest_mandatory_rate_not_above_the_frames():
    answers = {mode: response_mode(phy_mode(mode, 80)).name for mode in ALL_MODES}
    assert {mode for mode, answer in answers.items() if answer == "ofdm6"} == {"ofdm6", "ofdm9", "vht_mcs0"}
    assert {mode for mode, answer in answers.items() if answer == "ofdm12"} == {
        "ofdm12",
        "ofdm18",
        "vht_mcs1",
        "vht_mcs2",
    }
    assert answers["ofdm24"] == answers["ofdm54"] == answers["vht_mcs9"] == "ofdm24"


def test_noise_and_friis_match_reference_values():
    for width, noise_dbm in ((20, -93.99), (40, -90.98), (80, -87.97)):
        # the sheet takes 290 K; so do we
        assert 10 * np.log10(thermal_noise_mw(width, 7.0)) == pytest.approx(noise_dbm, abs=0.03)
    assert friis_loss_db(1.0, 5180.0) == pytest.approx(46.73, abs=0.01)
    assert friis_loss_db(100.0, 5180.0) == pytest.approx(86.73, abs=0.01)


REST = [(0.0, 0.0, 0.0)] * 2


def links(stations=2, **settings):
    config = RadioConfig(frequency_mhz=5180.0, rician_k_db=None, **settings)
    trajectories = Trajectories(stations)
    return make_links(config, trajectories, stations, seed=5), trajectories


def test_received_power_falls_with_the_exponent_and_follows_the_vehicles():
    budget, trajectories = links(path_loss_exponent=2.6)
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    at_10_m = budget.row(0, 0)
    assert 10 * np.log10(at_10_m.powers_mw[1]) == pytest.approx(16.0 - 46.73 - 26.0, abs=0.01)
    assert at_10_m.delays_ns.tolist() == [0, 33]
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0)])
    assert trajectories.distance_m(0, 1, 500_000_000) == pytest.approx(55.0)
    assert 10 * np.log10(budget.row(0, 1_000_000_000).powers_mw[1]) == pytest.approx(
        16.0 - 46.73 - 52.0, abs=0.01
    )


def test_extra_attenuation_is_set():
    budget, trajectories = links(extra_attenuation_db=3.0)
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    configured_mw = budget.row(0, 0).powers_mw[1]
    budget.set_extra_attenuation_db(23.0)
    assert budget.row(0, 0).powers_mw[1] == pytest.approx(configured_mw / 100)
    budget.set_extra_attenuation_db(3.0)
    assert budget.row(0, 0).powers_mw[1] == configured_mw


def test_unchanged_attenuation_keeps_the_cache():
    budget, trajectories = links()
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    budget.set_extra_attenuation_db(5.0)
    row = budget.row(0, 0)
    budget.set_extra_attenuation_db(5.0)
    assert budget.row(0, 0) is row


def test_budget_of_a_moving_station_expires():
    budget, trajectories = links()
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (2500.0, 0.0, 0.0)])
    assert budget.row(0, 2_000_000).delays_ns[1] == 50  # 15 m half-way
    trajectories.set(4_000_000, [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0)], REST)
    assert budget.row(0, 4_000_000).delays_ns[1] == 67  # 20 m
    row = budget.row(0, 4_000_000)
    trajectories.set(8_000_000, [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0)], REST)
    assert budget.row(0, 60_000_000) is row


@pytest.mark.parametrize(("later_us", "captured"), [(8, True), (30, False)])
def test_stronger_frame_captures_only_during_the_preamble(later_us, captured):
    # A and B do not receive each other; at C the later frame is 20 dB stronger
    hidden = {(A, B): -200.0, (B, A): -200.0, (A, C): -70.0, (B, C): -50.0}
    air = Air(3, powers_dbm=hidden)
    air.send(1000, A)
    air.send(1000 + later_us, B)
    air.run()
    from_a, from_b = air.transmissions
    assert C in from_a.collided
    assert C in (from_b.delivered if captured else from_b.collided)


def test_losses_have_the_reason_that_the_ratio_gives():
    # -91 dBm is 3 dB above the noise: no preamble is detected, with or without other transmissions
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


def test_weak_frame_defers_others_for_its_duration():
    # -64 dBm each: A ends at 1160, B at 1288 (20 + 4 ceil(1622 / 24)), and C waits DIFS after B
    air = Air(4, powers_dbm={(A, C): -64.0, (B, C): -64.0}, backoffs={C: [(0, 15)]})
    air.send(1000, A)
    air.send(1000, B, frame_bytes=200)
    air.send(1100, C)
    assert next(frame for frame in air.run() if frame[2] == C)[0] == 1292 + 34


@pytest.mark.parametrize("power_dbm", [-50.0, -70.0])
@pytest.mark.parametrize(("later_us", "deferred"), [(4, False), (5, True)])
def test_energy_is_not_sensed_for_four_microseconds(power_dbm, later_us, deferred):
    air = Air(2, powers_dbm={(A, B): power_dbm, (B, A): power_dbm}, backoffs={B: [(0, 15)]})
    air.send(1000, A)
    air.send(1000 + later_us, B)
    (start_us,) = [frame[0] for frame in air.run() if frame[2] == B]
    assert start_us == (1160 + 34 if deferred else 1000 + later_us)


def test_no_reception_beyond_a_delay_of_sifs():
    """16 us are 4796.7 m."""
    budget, trajectories = links(3, tx_power_dbm=50.0)
    trajectories.set(0, [(0.0, 0.0, 0.0), (4796.0, 0.0, 0.0), (-4797.0, 0.0, 0.0)], REST + REST[:1])
    row = budget.row(0, 0)
    assert row.powers_mw[1] > 0.0
    assert row.delays_ns.tolist() == [0, 15_998, 0]
    assert (row.powers_mw[2], row.longest_delay_ns) == (0.0, 15_998)


def test_longest_delay_includes_all_stations_that_can_sense():
    # 77 dB under the 16 dBm less 46.7 of 1 m: -108 dBm, under the noise of 50 dB less 20
    budget, trajectories = links(noise_figure_db=50.0, cca_preamble_dbm=-100.0)
    trajectories.set(0, [(0.0, 0.0, 0.0), (3000.0, 0.0, 0.0)], REST)
    assert budget.row(0, 0).longest_delay_ns == 10_007


@pytest.mark.parametrize("value", [-1e5, -0.1, float("nan"), float("inf")])
def test_invalid_attenuations_are_rejected(value):
    budget, trajectories = links()
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], REST)
    row = budget.row(0, 0)
    with pytest.raises(ValueError, match="attenuation of"):
        budget.set_extra_attenuation_db(value)
    assert budget.row(0, 0) is row


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("frequency_mhz", 100.0, 100_000.0),
        ("cca_energy_dbm", -100.0, 0.0),
        ("cca_preamble_dbm", -100.0, 0.0),
        ("nlos_duration_s", 0.01, 1e6),
    ],
)
def test_settings_are_range_checked(name, least, most):
    for value in (least, most):
        assert getattr(msgspec.convert({name: value}, RadioConfig), name) == value
    for value in (least - 1e-3, most * 1.01 + 1e-3):
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({name: value}, RadioConfig)

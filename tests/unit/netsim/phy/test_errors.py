"""Packet errors against ns-3's, and against the counts and bounds behind them."""

import csv
import math
from itertools import pairwise

import numpy as np
import pytest
from paths import REFERENCE as REFERENCE_FOLDER

from netsim.phy.errors import error_table, hard_decision_bound, packet_error_rate, soft_decision_bound
from netsim.phy.modes import phy_mode
from netsim.phy.vht_tables import VHT_COUNTS

VHT = [f"vht_mcs{i}" for i in range(10)]
NON_HT = [f"ofdm{rate}" for rate in (6, 9, 12, 18, 24, 36, 48, 54)]
MODES = NON_HT + VHT
TWINS = list(zip(VHT[:7], [rate for rate in NON_HT if rate != "ofdm9"], strict=True))
"""VHT modes and the non-HT ones of the same constellation and code rate."""


def linear(db):
    return 10.0 ** (db / 10.0)


def snr_db_at(rate, mode, frame_bytes):
    low_db, high_db = -10.0, 45.0
    while high_db - low_db > 1e-3:
        middle_db = (low_db + high_db) / 2
        if packet_error_rate(mode, frame_bytes, linear(middle_db)) > rate:
            low_db = middle_db
        else:
            high_db = middle_db
    return low_db


def reference():
    """Curves of ns-3 3.37: (mode, bytes) -> [(dB, packet error rate)], NIST's for non-HT, tables' for VHT."""
    curves = {}
    with (REFERENCE_FOLDER / "ns3_per.csv").open() as file:
        for row in csv.DictReader(file):
            column = "per_table" if row["mode"].startswith("vht") else "per_nist"
            curve = curves.setdefault((row["mode"], int(row["bytes"])), [])
            curve.append((float(row["snr_db"]), float(row[column])))
    return curves


def crossing_db(curve, rate):
    """Ratio at which a curve falls to a rate, log-linear between its points."""
    for (db, above), (next_db, below) in pairwise(curve):
        if above > rate >= below > 0.0:
            return db + (next_db - db) * math.log(above / rate) / math.log(above / below)
    raise AssertionError("the curve does not cross")


REFERENCE = reference()


@pytest.mark.parametrize(("mode", "frame_bytes"), REFERENCE)
def test_packet_error_rates_match_ns3(mode, frame_bytes):
    """Within 0.1 dB of its tables over the waterfall; of its NIST model, whose formula is ours, 0.05 dB.

    ns-3 makes frames below 400 bytes from a table of 32 bytes. That of MCS 7 contradicts its table of 1458:
    from 19 to 20.5 dB its hazard per bit is twice as high, which is 0.2 dB at 0.1 and more below.
    """
    limit_db = 0.1 if mode in VHT else 0.05
    curve = REFERENCE[mode, frame_bytes]
    for rate in (0.5, 0.1, 0.01):
        if mode == "vht_mcs7" and frame_bytes < 400:
            limit_db = 0.3 if rate >= 0.1 else 0.5
        distance_db = snr_db_at(rate, phy_mode(mode, 80), frame_bytes) - crossing_db(curve, rate)
        assert abs(distance_db) < limit_db


@pytest.mark.parametrize("name", MODES)
def test_errors_fall_with_the_ratio_and_grow_with_the_length(name):
    mode = phy_mode(name, 80)
    ratios = [linear(db) for db in np.arange(-12.0, 47.0, 0.33)]
    rates = [packet_error_rate(mode, 500, ratio) for ratio in ratios]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] == pytest.approx(1.0)
    assert rates[-1] == 0.0
    for ratio in ratios:
        by_length = [packet_error_rate(mode, length, ratio) for length in (32, 100, 1458, 4000)]
        assert by_length == sorted(by_length)


@pytest.mark.parametrize("name", MODES)
def test_hazards_add_over_the_bits(name):
    """A frame survives if both of its halves do."""
    mode = phy_mode(name, 80)
    for rate in (0.9, 0.3, 1e-3):
        ratio = linear(snr_db_at(rate, mode, 600))
        survival = 1.0 - packet_error_rate(mode, 300, ratio)
        assert 1.0 - packet_error_rate(mode, 600, ratio) == pytest.approx(survival**2, rel=1e-9)


@pytest.mark.parametrize("name", NON_HT)
def test_the_hazard_of_non_ht_follows_the_formula(name):
    mode = phy_mode(name, 20)
    for db in np.arange(-12.0, 47.0, 0.33):
        exact = hard_decision_bound(mode, linear(db))
        if 1e-12 < exact < 1e-2:
            assert error_table(mode).hazard_per_bit(linear(db)) == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("name", VHT)
def test_hazard_of_vht_matches_the_counts(name):
    """In every row up to the last dB; there in all its rows together, each within four standard errors."""
    mode = phy_mode(name, 80)
    hazard = error_table(mode).hazard_per_bit
    rows = VHT_COUNTS[name]
    for snr_db, frame_bytes, frames, lost in rows[:-4]:
        counted = -math.log1p(-lost / frames) / (8 * frame_bytes)
        assert hazard(linear(snr_db)) == pytest.approx(counted, rel=1e-6)
    expected = [packet_error_rate(mode, row[1], linear(row[0])) * row[2] for row in rows[-4:]]
    assert sum(expected) == pytest.approx(sum(row[3] for row in rows[-4:]), rel=0.01)
    for (_, _, _, lost), mean in zip(rows[-4:], expected, strict=True):
        assert abs(lost - mean) < 4.0 * math.sqrt(mean)


@pytest.mark.parametrize("name", VHT)
def test_counts_range_from_certain_loss_to_one_in_a_thousand(name):
    _, short_bytes, short_frames, short_lost = VHT_COUNTS[name][0]
    _, long_bytes, long_frames, long_lost = VHT_COUNTS[name][-1]
    assert short_bytes == 32
    assert long_bytes == 1458
    assert 0.95 < short_lost / short_frames < 1.0
    assert 0 < long_lost / long_frames <= 1e-3


@pytest.mark.parametrize("name", VHT)
def test_hazard_is_extrapolated_beyond_the_counts(name):
    """Above, its slope in e-folds per dB goes on growing with the ratio; far below, the decoder guesses."""
    hazard = error_table(phy_mode(name, 80)).hazard_per_bit
    last_db = VHT_COUNTS[name][-1][0]
    before, at, after = (math.log(hazard(linear(last_db + d))) for d in (-1.0, 0.0, 1.0))
    assert before - at < at - after < 1.9 * (before - at)
    assert hazard(0.0) == hazard(linear(-10.0)) == pytest.approx(math.log(2.0))


def test_qpsk_equals_two_bpsk_of_half_the_power():
    """The same code at 3.01 dB more: the hazard is the same, on average over 13 points known to 10 % each."""
    bpsk, qpsk = (error_table(phy_mode(f"vht_mcs{i}", 80)) for i in (0, 1))
    ratios = linear(np.arange(-2.0, 1.1, 0.25))
    logs = [math.log(qpsk.hazard_per_bit(2.0 * ratio) / bpsk.hazard_per_bit(ratio)) for ratio in ratios]
    assert abs(np.mean(logs)) < 4 * 0.1 / math.sqrt(len(logs))


@pytest.mark.parametrize(("soft", "hard"), TWINS)
def test_soft_decisions_gain_over_hard_ones(soft, hard):
    """The same constellation and code rate: 2 dB by the textbook, and as NIST's is a bound, some more."""
    gain_db = snr_db_at(0.1, phy_mode(hard, 20), 300) - snr_db_at(0.1, phy_mode(soft, 20), 300)
    assert 2.0 < gain_db < 6.0
    bound_db = 10.0 * math.log10(
        next(
            ratio
            for ratio in map(linear, np.arange(-5.0, 45.0, 0.01))
            if 2400 * soft_decision_bound(phy_mode(soft, 20), ratio) < 0.1
        )
    )
    assert snr_db_at(0.1, phy_mode(soft, 20), 300) < bound_db

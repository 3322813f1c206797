"""The link simulation behind the packet error tables against the theory of its code.

About 7 s, and 10 more when the kernels are compiled.
"""

import math
from itertools import pairwise

import numpy as np
import pytest

from netsim.phy.errors import packet_error_rate
from netsim.phy.modes import phy_mode
from netsim.phy.vht_tables import VHT_COUNTS
from studies.link_tables.link_level import Link, amplitudes, encode, interleaver, sent_positions
from studies.link_tables.tables import rows

VHT = [f"vht_mcs{i}" for i in range(10)]


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


def first_event_weights(longest):
    """Paths a_d through the trellis that leave state 0 and come back once, by weight d, from the encoder."""
    impulse = np.zeros((1, 7), np.uint8)
    impulse[0, 0] = 1
    response = encode(impulse).reshape(7, 2)
    step = {
        (state, bit): (
            ((state << 1) | bit) & 63,
            int(((response * [[((state << 1 | bit) >> d) & 1] for d in range(7)]).sum(axis=0) % 2).sum()),
        )
        for state in range(64)
        for bit in (0, 1)
    }
    weights = np.zeros(longest + 1)
    start, weight = step[0, 1]
    alive = {start: np.eye(1, longest + 1, weight)[0]}
    while alive:
        following = {}
        for state, paths in alive.items():
            for bit in (0, 1):
                target, more = step[state, bit]
                moved = np.zeros_like(paths)
                moved[more:] = paths[: longest + 1 - more]
                if target == 0:
                    weights += moved
                elif moved.any():
                    following[target] = following.get(target, 0.0) + moved
        alive = following
    return weights


def test_the_free_distance_of_the_code_is_ten_and_eleven_paths_have_it():
    """The spectrum of 133/171 that the textbooks print begins 11, 0, 38, 0, 193."""
    assert first_event_weights(14).tolist() == [0] * 10 + [11, 0, 38, 0, 193]


def test_with_whole_frames_of_memory_bpsk_at_rate_one_half_meets_its_union_bound():
    """A frame fails with at most sum a_d Q(sqrt(2 d g)) per bit, hardly less where errors are rare.

    At 1 dB: Q falls by e^-1.26 per unit of d, so that d up to 30 are more than 99.9 % of the sum. Some 90 of
    2000 frames are lost, with a standard error of 10 %.
    """
    snr_linear = linear(1.0)
    link = Link(phy_mode("vht_mcs0", 80), 1458, delay=10**6)
    counted = link.count(snr_linear, np.random.default_rng(4), frames=2000, enough=2000)
    hazard = -math.log1p(-counted.rate) / (8 * 1458)
    bound = sum(0.5 * a * math.erfc(math.sqrt(d * snr_linear)) for d, a in enumerate(first_event_weights(30)))
    assert 0.6 * bound < hazard < 1.3 * bound


@pytest.mark.parametrize("name", ["vht_mcs0", "vht_mcs5"])
def test_early_decisions_cost_a_few_tenths_of_a_decibel(name):
    """With the rule's delay more frames are lost than with whole frames of memory, as few as 0.8 dB below."""
    mode = phy_mode(name, 80)
    snr_db = snr_db_at(0.3, mode, 300)

    def rate(shift_db, delay):
        link = Link(mode, 300, delay=delay)
        rng = np.random.default_rng(6)
        return link.count(linear(snr_db + shift_db), rng, frames=1000, enough=1000).rate

    # four standard errors of the difference of two counts of 300 in 1000 are 0.08
    assert rate(0.0, 10**6) + 0.08 < rate(0.0, None) < rate(-0.8, 10**6) - 0.08


def test_encoder_reproduces_the_standards_signal_field():
    """24 bits at 36 Mbit/s and a length of 100, coded: IEEE 802.11-2016, I.1.4.2 and I.1.4.3."""
    signal = "101100010011000000000000"
    coded = "110100011010000100000010001111100111000000000000"
    bits = np.array([[int(bit) for bit in signal]], np.uint8)
    assert "".join(map(str, encode(bits)[0])) == coded


def test_puncturing_matches_the_standard():
    """A0 B0 A1; A0 B0 A1 B2; A0 B0 A1 B2 A3 B4: A is at even places, B at odd ones (17.3.5.6, 19.3.11.6)."""
    assert sent_positions((1, 2), 2).tolist() == [0, 1, 2, 3]
    assert sent_positions((2, 3), 4).tolist() == [0, 1, 2, 4, 5, 6]
    assert sent_positions((3, 4), 3).tolist() == [0, 1, 2, 5]
    assert sent_positions((5, 6), 5).tolist() == [0, 1, 2, 5, 6, 9]


@pytest.mark.parametrize(("width", "apart"), [(20, 4), (40, 6), (80, 9)])
@pytest.mark.parametrize("name", VHT)
def test_interleaver_permutes_and_separates_neighbours(name, width, apart):
    """Neighbouring bits go to subcarriers N_ROW / N_BPSCS apart, but where a row of N_COL ends."""
    if name == "vht_mcs9" and width == 20:
        return
    mode = phy_mode(name, width)
    place = interleaver(mode)
    assert np.array_equal(np.sort(place), np.arange(place.size))
    subcarrier = place // mode.bits_per_subcarrier
    columns = {20: 13, 40: 18, 80: 26}[width]
    steps = np.diff(subcarrier)
    assert np.all(steps[np.arange(steps.size) % columns != columns - 1] == apart)


def test_amplitudes_match_the_standard():
    """64-QAM, one axis (table 17-15): -7 is 000, then 001, 011, 010, 110, 111, 101, 100."""
    order = [f"{value:03b}" for value in np.argsort(amplitudes(3))]
    assert order == ["000", "001", "011", "010", "110", "111", "101", "100"]
    for bits in (1, 2, 3, 4):
        levels = amplitudes(bits)
        assert np.array_equal(np.sort(levels), np.arange(1 - 2**bits, 2**bits, 2))
        by_level = np.argsort(levels)
        assert all(int(a ^ b).bit_count() == 1 for a, b in pairwise(by_level))


@pytest.mark.parametrize("width", [20, 40, 80])
@pytest.mark.parametrize("name", VHT)
def test_without_noise_every_frame_arrives(name, width):
    if name == "vht_mcs9" and width == 20:
        return
    rng = np.random.default_rng(3)
    link = Link(phy_mode(name, width), 60)
    bits = link.data(3, rng)
    assert np.array_equal(link.receive(link.transmit(bits), linear(60.0), rng), bits)


@pytest.mark.parametrize("wrong", [4, 6])
def test_decoder_selects_the_nearer_of_two_words_at_the_free_distance(wrong):
    """One bit more or less changes ten amplitudes of BPSK: with four of them wrong it is put right.

    With six wrong the other word is the nearer one.
    """
    rng = np.random.default_rng(wrong)
    link = Link(phy_mode("vht_mcs0", 80), 60)
    bits = link.data(20, rng)
    other = bits.copy()
    other[np.arange(20), rng.integers(0, bits.shape[1] - 6, 20)] ^= 1
    sent, there = link.transmit(bits), link.transmit(other)
    for word, toward in zip(sent, there, strict=True):
        differing = np.flatnonzero(word != toward)
        assert differing.size == 10
        flipped = rng.choice(differing, wrong, replace=False)
        word[flipped] = toward[flipped]
    assert np.array_equal(link.receive(sent, linear(60.0), rng), bits if wrong == 4 else other)


@pytest.mark.parametrize(
    ("name", "frame_bytes", "frames"),
    [("vht_mcs1", 100, 3000), ("vht_mcs4", 300, 1200), ("vht_mcs9", 700, 700)],
)
def test_a_simulation_of_other_lengths_agrees_with_the_tables(name, frame_bytes, frames):
    """One hazard serves all lengths: at a rate of 0.3 the count is within four of its standard errors.

    The table's own 5 % and the 5 % by which the hazard depends on the length come on top.
    """
    mode = phy_mode(name, 80)
    ratio = linear(snr_db_at(0.3, mode, frame_bytes))
    counted = Link(mode, frame_bytes).count(ratio, np.random.default_rng(8), frames=frames, enough=frames)
    assert counted.rate == pytest.approx(0.3, abs=4.0 * math.sqrt(0.21 / counted.frames) + 0.03)


def test_committed_table_is_reproduced_by_its_seed():
    assert next(rows(phy_mode("vht_mcs0", 80), seed=1)) == VHT_COUNTS["vht_mcs0"][0]

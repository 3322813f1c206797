"""Tests of pattern features: solid angles, the article's region, symmetry, area of the main lobe (2 s)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antenna.analysis.patterns import FLOOR_DBI, HALF_POWER_DB, Pattern, directions_deg, from_dbi
from harness.records.flight import Flight
from studies.article.patterns import (
    LEVEL_DBI,
    difference_db,
    in_region,
    lobe_sr,
    mean_gain_dbi,
    mean_pattern,
    mirrored,
    read_pattern,
    solid_angles_sr,
)
from studies.article.retained_flights import FLOWN, IN_PLACE, UPRIGHT, tilts_rad, variants


def pattern(gain_of, step_deg=1.0):
    """Make a pattern from a function that returns gains in dBi for theta and phi in degrees."""
    theta_deg, phi_deg = directions_deg(step_deg)
    gain_dbi = np.broadcast_to(
        gain_of(*np.meshgrid(theta_deg, phi_deg, indexing="ij")), (len(theta_deg), len(phi_deg))
    ).astype(float)
    row, column = np.unravel_index(int(gain_dbi.argmax()), gain_dbi.shape)
    return Pattern(
        theta_deg=theta_deg, phi_deg=phi_deg, theta_gain_dbi=gain_dbi,
        phi_gain_dbi=np.full(gain_dbi.shape, FLOOR_DBI), max_gain_dbi=float(gain_dbi[row, column]),
        max_theta_deg=float(theta_deg[row]), max_phi_deg=float(phi_deg[column]), average_gain=1.0,
        backend="made up",
    )  # fmt: skip


def level(gain_dbi):
    """Return a constant gain."""
    return lambda *_: np.array(gain_dbi)


def beam(theta_deg, phi_deg, towards_deg=90.0, top_dbi=10.0):
    """Return a gain that falls by 1 dB for every 10 degrees from a horizontal direction."""
    cosine = np.sin(np.radians(theta_deg)) * np.cos(np.radians(phi_deg - towards_deg))
    return top_dbi - np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) / 10.0


@given(step_deg=st.sampled_from([1.5, 3.0, 5.0, 7.0]))
def test_solid_angles_add_up_to_the_sphere(step_deg):
    """A cap to 45 degrees, the edge between two rows, has 2 pi (1 - cos 45 deg); here rows of 6 end at 45."""
    assert solid_angles_sr(*directions_deg(step_deg)).sum() == pytest.approx(4.0 * math.pi)
    theta_deg, phi_deg = directions_deg(6.0)
    cap = solid_angles_sr(theta_deg, phi_deg)[theta_deg < 45.0].sum()
    assert cap == pytest.approx(2.0 * math.pi * (1.0 - math.cos(math.radians(45.0))))


def test_region_includes_its_bounds():
    """At 15 degrees theta has 0, 15, 30, 45 and phi 180, 195, 210, 225: 16 directions."""
    region = in_region(pattern(level(0.0), 15.0))
    assert region.sum() == 16
    assert region[:4, 12:16].all()


def test_region_with_less_gain_has_the_deficit():
    """6 dB less in the region only changes the region only."""
    ideal = pattern(level(3.0))
    less = replace(ideal, theta_gain_dbi=ideal.theta_gain_dbi - 6.0 * in_region(ideal))
    found, same = read_pattern(less, ideal), read_pattern(ideal, ideal)
    assert same.region_dbi - found.region_dbi == pytest.approx(6.0)
    assert same.region_max_dbi - found.region_max_dbi == pytest.approx(6.0)
    weights = solid_angles_sr(ideal.theta_deg, ideal.phi_deg)
    share = weights[in_region(ideal)].sum() / weights.sum()
    assert found.lower_share == pytest.approx(share)
    assert found.difference_db == pytest.approx(6.0 * math.sqrt(share))
    assert (same.lower_share, same.difference_db, same.asymmetry_db) == (0.0, 0.0, 0.0)


def test_symmetry_is_about_the_broadside_axis():
    """A beam along +y is its own mirror image; one 10 degrees from it differs by up to 2 dB."""
    straight, askew = (pattern(lambda t, p, at=at: beam(t, p, at)) for at in (90.0, 100.0))
    assert read_pattern(straight, straight).asymmetry_db == pytest.approx(0.0, abs=1e-9)
    assert 0.5 < read_pattern(askew, straight).asymmetry_db <= 2.0
    assert np.allclose(mirrored(askew.gain_dbi), pattern(lambda t, p: beam(t, p, 80.0)).gain_dbi)
    assert np.array_equal(mirrored(mirrored(askew.gain_dbi)), askew.gain_dbi)


def test_gains_below_the_level_are_limited():
    """Nulls of -40 and -60 dBi are equal; a lobe of -4 dBi differs from a null by 6 dB."""
    weights = np.ones((1, 4))
    nulls, deeper = np.full((1, 4), -40.0), np.full((1, 4), -60.0)
    assert difference_db(nulls, deeper, weights) == 0.0
    lobe = np.array([[LEVEL_DBI + 6.0, -40.0, -40.0, -40.0]])
    assert difference_db(lobe, deeper, weights) == pytest.approx(
        6.0
    )  # one direction, where one gain is above


def test_lobe_has_the_area_of_its_cap_without_other_lobes():
    """1 dB per 10 degrees: half power is reached 30.1 degrees off, a cap of 2 pi (1 - cos 30.1 deg)."""
    made = pattern(beam)
    cap_sr = 2.0 * math.pi * (1.0 - math.cos(math.radians(10.0 * HALF_POWER_DB)))
    found = read_pattern(made, made)
    assert found.lobe_sr == pytest.approx(cap_sr, rel=0.01)
    two = pattern(lambda t, p: np.maximum(beam(t, p), beam(t, p, 270.0, 9.5)))
    assert read_pattern(two, made).lobe_sr == pytest.approx(cap_sr, rel=0.01)
    lower = pattern(lambda t, p: beam(t, p, top_dbi=9.0))  # the same lobe with a smaller part above 7 dBi
    found = read_pattern(lower, made)
    assert found.lobe_sr == pytest.approx(cap_sr, rel=0.01)
    smaller_sr = 2.0 * math.pi * (1.0 - math.cos(math.radians(10.0 * (HALF_POWER_DB - 1.0))))
    assert found.effective_lobe_sr == pytest.approx(smaller_sr, rel=0.01)
    assert lobe_sr(lower, 9.5) == 0.0


def test_patterns_of_different_grids_are_rejected():
    with pytest.raises(ValueError, match="ideal pattern of"):
        read_pattern(pattern(beam, 5.0), pattern(beam, 3.0))


def test_mean_pattern_is_the_mean_of_power():
    """The mean of gains 2 and 4 is 3, in every direction and over all directions."""
    mean = mean_pattern(pattern(level(10.0 * math.log10(gain)), 10.0) for gain in (2.0, 4.0))
    assert from_dbi(mean.gain_dbi) == pytest.approx(3.0)
    assert mean.average_gain == pytest.approx(3.0)
    assert mean_gain_dbi(mean.gain_dbi, solid_angles_sr(mean.theta_deg, mean.phi_deg)) == pytest.approx(
        10.0 * math.log10(3.0)
    )


def test_mean_of_no_pattern_is_none_and_of_two_grids_rejected():
    assert mean_pattern(iter(())) is None
    with pytest.raises(ValueError, match="among"):
        mean_pattern([pattern(beam, 5.0), pattern(beam, 3.0)])


def test_variants_set_a_flight_upright_and_in_place():
    """A tilt of 20 degrees about an axis between north and east, under a heading of 30 degrees."""
    half = math.radians(10.0)
    q = np.array([math.cos(half), math.sin(half) * 0.6, math.sin(half) * 0.8, 0.0])
    flight = Flight(
        time_us=np.arange(2), pos_ned_m=np.ones((2, 3, 3)), q_ned_frd=np.tile(q, (2, 3, 1)),
        desired_pos_ned_m=np.zeros((2, 3, 3)), heading_rad=np.full(2, math.radians(30.0)),
        alive=np.ones((2, 3), bool),
    )  # fmt: skip
    assert np.degrees(tilts_rad(flight.q_ned_frd)) == pytest.approx(20.0)
    made = variants(flight)
    assert made[FLOWN] is flight
    assert tilts_rad(made[UPRIGHT].q_ned_frd) == pytest.approx(0.0)
    w, _, _, z = made[UPRIGHT].q_ned_frd[0, 0]
    assert 2.0 * math.degrees(math.atan2(z, w)) == pytest.approx(30.0)
    assert np.array_equal(made[UPRIGHT].pos_ned_m, flight.pos_ned_m)
    assert np.array_equal(made[IN_PLACE].pos_ned_m, flight.desired_pos_ned_m)
    assert np.array_equal(made[IN_PLACE].q_ned_frd, flight.q_ned_frd)

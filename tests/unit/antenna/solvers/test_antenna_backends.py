"""The three backends side by side, over elements, grounds and attitudes. Costs 6 s.

nec2c shares no code with PyNEC's wrapper, and the batch solver none with either.
"""

import shutil

import numpy as np
import pytest
from antenna_arrays import ideal, perturbed, vertical_snapshot
from antenna_hertzian import gain_dbi
from msgspec import structs

from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot, grid
from antenna.solvers import nec2c
from antenna.solvers.interface import Accuracy
from antenna.solvers.nec2c import Nec2cFailed, Nec2cFarField
from antenna.solvers.selection import make_backend

LAMBDA_M = 10.0
SHORT = {}
LONG = {"element_length_m": 5.0, "element_radius_m": 0.001, "segments": 11}
LOOP = {"element_kind": "loop", "element_length_m": 1.0, "element_radius_m": 0.001, "segments": 12}
OCTAGON = LOOP | {"segments": 8}
MONOPOLE = """CE a dipole with two arms at its top
GW 1 9 0 0 -0.5 0 0 0.5 0.001
GW 2 3 0 0 0.5 0.3 0 0.6 0.001
GW 3 3 0 0 0.5 -0.3 0 0.6 0.001
GE 0
EX 0 1 5 0 1 0
EN
"""
DECK = {"element_kind": "deck", "element_deck": MONOPOLE}
PERFECT = {"ground": "perfect"}
LIMITS = {Accuracy.SMALL_ELEMENTS: (0.01, 0.1), Accuracy.LARGE_ELEMENTS: (0.05, 0.3)}
"""Of the maximum, and of the pattern above -20 dBi, in dB."""


def _snapshots(seed, count, height_m=0.0):
    """0.5 m and 10 degrees about the article's places, centres no nearer than 1 m."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        snapshot = perturbed(rng, LAMBDA_M, 0.5, tilt_rad=np.radians(10.0))
        apart_m = np.linalg.norm(snapshot.centres_m[:, None] - snapshot.centres_m, axis=-1) + 9.0 * np.eye(8)
        if apart_m.min() > 1.0:
            centres_m = snapshot.centres_m + np.array([0.0, 0.0, height_m])
            found.append(Snapshot(centres_m, snapshot.rotations, snapshot.voltages))
    return found


def _compare(found, witness, limits_db):
    for one, other in zip(found, witness, strict=True):
        assert one.max_gain_dbi == pytest.approx(other.max_gain_dbi, abs=limits_db[0])
        for name in ("gain_dbi", "theta_gain_dbi", "phi_gain_dbi"):
            mine, theirs = getattr(one, name), getattr(other, name)
            seen = theirs > (-20.0 if name == "gain_dbi" else -10.0)
            if seen.any():
                assert np.abs(mine - theirs)[seen].max() < limits_db[1], name
        assert one.average_gain == pytest.approx(other.average_gain, abs=0.003)


@pytest.mark.nec2
@pytest.mark.parametrize(
    "element", [SHORT, LONG, LOOP, OCTAGON, DECK], ids=["short", "long", "loop", "octagon", "deck"]
)
@pytest.mark.parametrize("ground", [{}, PERFECT], ids=["free", "perfect"])
def test_batch_matches_nec2_within_its_accuracy_class(element, ground):
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    config = AntennaConfig(wavelength_m=LAMBDA_M, **element, **ground)
    snapshots = _snapshots(31, 12, 10.0 if ground else 0.0)
    batch = make_backend(config)
    witness = make_backend(structs.replace(config, backend="nec2")).patterns(snapshots)
    _compare(batch.patterns(snapshots), witness, LIMITS[batch.accuracy])


@pytest.mark.nec2
@pytest.mark.parametrize("wavelength_m", [20.0, 40.0])
def test_batch_matches_nec2_except_for_the_power_of_faint_elements(wavelength_m):
    """In directivity, the gain over the average gain, and the pattern of it; grids of 5 degrees suffice."""
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    config = AntennaConfig(wavelength_m=wavelength_m)
    rng = np.random.default_rng(35)
    snapshots = [perturbed(rng, wavelength_m, 0.5, tilt_rad=0.15) for _ in range(6)]
    batch, witness = make_backend(config), make_backend(structs.replace(config, backend="nec2"))
    assert batch.accuracy == Accuracy.FAINT_ELEMENTS
    for one, other in zip(batch.patterns(snapshots), witness.patterns(snapshots), strict=True):
        power_db = 10.0 * np.log10(one.average_gain / other.average_gain)
        assert one.max_gain_dbi - other.max_gain_dbi == pytest.approx(power_db, abs=0.01)
        apart_db = one.gain_dbi - other.gain_dbi - power_db
        assert np.abs(apart_db)[other.gain_dbi > -20.0].max() < 0.1


@pytest.mark.nec2
@pytest.mark.parametrize("step_deg", [4.0, 7.2, 20.0])
@pytest.mark.parametrize("ground", [{}, PERFECT], ids=["free", "perfect"])
def test_nec2c_matches_nec2_on_grids_of_an_odd_number_of_steps(step_deg, ground):
    """180 over 4, 7.2 and 20 is odd: the grid that has the horizon on it has smaller steps than these."""
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    if shutil.which("nec2c") is None:
        pytest.skip("the program nec2c is not installed")
    from antenna.solvers.nec2 import PynecFarField  # noqa: PLC0415 - needs PyNEC

    config = AntennaConfig(wavelength_m=LAMBDA_M, grid_deg=step_deg, backend="nec2c", **ground)
    (snapshot,) = _snapshots(36, 1, 10.0 if ground else 0.0)
    expected = PynecFarField(snapshot, config).partial_gains(step_deg)
    found = Nec2cFarField(snapshot, config).partial_gains(step_deg)
    assert found == pytest.approx(expected, rel=0.005, abs=1e-3)
    witness = make_backend(structs.replace(config, backend="nec2")).patterns([snapshot])
    _compare(make_backend(config).patterns([snapshot]), witness, (0.002, 0.03))


@pytest.mark.parametrize("missing", [1, -72])
def test_incomplete_pattern_of_nec2c_is_a_one_line_error(monkeypatch, missing):
    if shutil.which("nec2c") is None:
        pytest.skip("the program nec2c is not installed")
    backend = make_backend(AntennaConfig(backend="nec2c"))
    monkeypatch.setattr(nec2c.Nec2cFarField, "_run", lambda *_: np.ones((37 * 72 - missing, 2)))
    given = rf"^nec2c returned {37 * 72 - missing} directions; expected 37 by 72$"
    with pytest.raises(Nec2cFailed, match=given):
        backend.patterns([ideal(LAMBDA_M)])


@pytest.mark.nec2
@pytest.mark.parametrize("element", [SHORT, LONG, DECK], ids=["short", "long", "deck"])
@pytest.mark.parametrize("ground", [{}, PERFECT, {"ground": "real"}], ids=["free", "perfect", "real"])
def test_nec2c_matches_nec2(element, ground):
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")
    if shutil.which("nec2c") is None:
        pytest.skip("the program nec2c is not installed")
    config = AntennaConfig(wavelength_m=LAMBDA_M, grid_deg=10.0, backend="nec2c", **element, **ground)
    snapshots = _snapshots(32, 3, 10.0 if ground else 0.0)
    witness = make_backend(structs.replace(config, backend="nec2")).patterns(snapshots)
    _compare(make_backend(config).patterns(snapshots), witness, (0.002, 0.03))


@pytest.mark.parametrize("wavelength_m", [5.0, 7.5, 10.0, 15.0, 20.0])
def test_ideal_formation_has_13_26_dbi_along_endfire(wavelength_m):
    """NEC2's segments cost 0.018 dB, its average gain of 0.996; without them the exact 13.280 are left."""
    (pattern,) = make_backend(AntennaConfig(wavelength_m=wavelength_m)).patterns([ideal(wavelength_m)])
    assert pattern.max_gain_dbi == pytest.approx(13.262, abs=0.002)
    assert (pattern.max_theta_deg, pattern.max_phi_deg) == pytest.approx((90.0, 90.0), abs=0.1)
    assert pattern.max_gain_dbi - 10.0 * np.log10(pattern.average_gain) == pytest.approx(13.280, abs=0.001)


def test_batch_matches_hertzian_dipoles_for_short_dipoles():
    """Against the closed form, however the dipoles stand and lean; NEC2's bias is in the average."""
    rng = np.random.default_rng(33)
    snapshots = [perturbed(rng, LAMBDA_M, sigma, tilt_rad=0.3) for sigma in (0.1, 0.5, 1.0, 2.0, 4.0)]
    for snapshot, pattern in zip(snapshots, make_backend(AntennaConfig()).patterns(snapshots), strict=True):
        exact_dbi = gain_dbi(snapshot, LAMBDA_M, pattern.theta_deg[:, np.newaxis], pattern.phi_deg)
        directivity_dbi = pattern.gain_dbi - 10.0 * np.log10(pattern.average_gain)
        seen = exact_dbi > -10.0
        assert np.abs(directivity_dbi - exact_dbi)[seen].max() < 0.02


def test_short_dipole_over_perfect_ground_has_the_gain_of_its_image():
    """Vertical, a quarter wavelength up: at the horizon its field is doubled.

    The gain is there 4 sin^2 theta over the mean over the sphere of 4 sin^2 theta cos^2(k h cos theta), of
    which there is none below the horizon: 1 / (1/3 + (sin x - x cos x) / x^3), x = 2 k h = pi.
    """
    x = np.pi
    expected = 1.0 / (1.0 / 6.0 + 0.5 * (np.sin(x) - x * np.cos(x)) / x**3)
    config = AntennaConfig(wavelength_m=LAMBDA_M, ground="perfect")
    (pattern,) = make_backend(config).patterns([vertical_snapshot(np.array([[0.0, 0.0, 2.5]]), LAMBDA_M)])
    assert pattern.max_gain_dbi == pytest.approx(10.0 * np.log10(expected), abs=0.02)
    assert pattern.max_theta_deg == pytest.approx(90.0, abs=0.5)
    assert (pattern.gain_dbi[19:] < -900.0).all()
    assert pattern.average_gain == pytest.approx(0.996, abs=0.01)


@pytest.mark.parametrize("threads", [1, 3])
def test_results_do_not_depend_on_threads_slices_and_element_counts(threads):
    rng = np.random.default_rng(34)
    snapshots = [perturbed(rng, LAMBDA_M, 0.5, count=8 - k % 3) for k in range(150)]
    snapshots[70].centres_m[3] = snapshots[70].centres_m[2]
    found = make_backend(AntennaConfig(grid_deg=15.0), threads=threads).patterns(snapshots)
    assert isinstance(found[70], ElementsTouch)
    assert (found[70].first, found[70].second) == (2, 3)
    alone = make_backend(AntennaConfig(grid_deg=15.0))
    for k in (0, 1, 2, 69, 71, 149):
        (one,) = alone.patterns([snapshots[k]])
        np.testing.assert_array_equal(one.theta_gain_dbi, found[k].theta_gain_dbi)
        assert one.max_gain_dbi == pytest.approx(found[k].max_gain_dbi, abs=1e-9)


def test_undriven_element_scatters_without_being_a_source():
    snapshot = vertical_snapshot(grid(2, 2, 5.0, 0.0), LAMBDA_M)
    snapshot.voltages[1] = 0.0
    (pattern,) = make_backend(AntennaConfig()).patterns([snapshot])
    assert pattern.max_gain_dbi - 10.0 * np.log10(pattern.average_gain) == pytest.approx(1.761, abs=0.005)


def test_batch_over_real_ground_is_rejected():
    with pytest.raises(
        ValueError, match=r"^backend: batch does not support real ground; expected nec2 or nec2c$"
    ):
        AntennaConfig(ground="real")

"""The antenna command line: closed-form values, gain loss by disorder, invalid input."""

import json
from itertools import islice

import numpy as np
import pytest
import xarray as xr
from antenna_arrays import perturbed
from antenna_hertzian import exact_patterns, gain_dbi
from msgspec import structs

from antenna.lab import runs
from antenna.lab.cli import main
from antenna.lab.formations import Disorder, draws
from antenna.lab.hertzian import hertzian_pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot, grid, upright
from antenna.solvers.ports import feed, ports
from antenna.solvers.selection import make_backend

LAMBDA_M = 10.0
CONFIG = AntennaConfig(wavelength_m=LAMBDA_M)
LONG = AntennaConfig(wavelength_m=LAMBDA_M, element_length_m=5.0, element_radius_m=0.001, segments=11)
NEC_BIAS_DB = 0.018
"""Nine segments on a short dipole radiate 0.9958 of what they take; NEC2 has that as well."""
PNG = b"\x89PNG"


def _run(capsys, command):
    """Run a command that succeeds; return its JSON."""
    status = main([*command.split(), "--json"])
    printed = capsys.readouterr()
    assert (status, printed.err) == (0, "")
    return json.loads(printed.out)


@pytest.mark.parametrize(
    ("formation", "excitation", "directivity_dbi"),
    [
        ("4x2", "end_fire", 13.280), ("4x2", "hansen_woodyard", 12.708), ("4x2", "optimum", 13.945),
        ("2x4", "end_fire", 11.037), ("2x4", "hansen_woodyard", 12.332), ("2x4", "optimum", 14.128),
    ],
)  # fmt: skip
def test_feeding_policies_match_hertzian_dipoles(capsys, formation, excitation, directivity_dbi):
    found = _run(capsys, f"pattern --formation {formation} --excitation {excitation} --wavelength 7.5")
    assert found["exact_directivity_dbi"] == pytest.approx(directivity_dbi, abs=0.001)
    assert found["max_gain_dbi"] == pytest.approx(directivity_dbi - NEC_BIAS_DB, abs=0.003)
    assert -10.0 * np.log10(found["average_gain"]) == pytest.approx(NEC_BIAS_DB, abs=0.002)
    assert (found["theta_deg"], found["phi_deg"]) == pytest.approx((90.0, 90.0), abs=0.1)
    assert found["towards_dbi"] == pytest.approx(found["max_gain_dbi"], abs=1e-4)
    assert found["pointing_error_deg"] < 0.1


@pytest.mark.parametrize(
    ("config", "height_m"), [(CONFIG, 0.0), (LONG, 0.0), (structs.replace(LONG, ground="perfect"), 12.0)]
)
def test_ports_predict_the_gain_of_any_voltages(config, height_m):
    """Admittances are reciprocal, and their gains those of whole patterns, at the pattern's own maximum."""
    rng = np.random.default_rng(7)
    for _ in range(3):
        moved = perturbed(rng, LAMBDA_M, tilt_rad=0.3)
        voltages = rng.normal(size=8) + 1j * rng.normal(size=8)
        array = Snapshot(moved.centres_m + np.array([0.0, 0.0, height_m]), moved.rotations, voltages)
        (pattern,) = make_backend(config).patterns([array])
        seen = ports(array, config, (pattern.max_theta_deg, pattern.max_phi_deg))
        assert 10.0 * np.log10(seen.gain(voltages)) == pytest.approx(pattern.max_gain_dbi, abs=1e-3)
        y = seen.admittance_s
        assert np.abs(y - y.T).max() < 1e-3 * np.abs(y).max()
        assert np.linalg.eigvalsh(y.real).min() > 0.0  # it takes power, however it is fed


@pytest.mark.parametrize("config", [CONFIG, LONG])
def test_optimum_is_a_local_maximum_of_gain(config):
    best = structs.replace(config, excitation="optimum")
    rng = np.random.default_rng(8)
    array = perturbed(rng, LAMBDA_M, tilt_rad=0.2)
    voltages = feed(array.centres_m, best, array.rotations)
    seen = ports(array, best)
    assert seen.gain(voltages) > seen.gain(feed(array.centres_m, config))
    for _ in range(50):
        other = voltages + 0.05 * (rng.normal(size=8) + 1j * rng.normal(size=8))
        assert seen.gain(other) < seen.gain(voltages)


def test_optimum_of_touching_elements_is_rejected():
    places_m = grid(8, 4, 8.5, 2.5)
    places_m[3] = places_m[2]
    with pytest.raises(ElementsTouch) as caught:
        feed(places_m, structs.replace(CONFIG, excitation="optimum"))
    assert (caught.value.first, caught.value.second) == (2, 3)


def test_closed_form_matches_the_independent_test_implementation():
    array = perturbed(np.random.default_rng(9), LAMBDA_M, tilt_rad=0.6)
    found, (witness,) = hertzian_pattern(array, LAMBDA_M, grid_deg=5.0), exact_patterns([array], LAMBDA_M)
    np.testing.assert_allclose(found.theta_gain_dbi, witness.theta_gain_dbi, atol=1e-8)
    np.testing.assert_allclose(found.phi_gain_dbi, witness.phi_gain_dbi, atol=1e-8)
    assert found.max_gain_dbi == pytest.approx(witness.max_gain_dbi, abs=1e-4)
    towards_dbi = gain_dbi(array, LAMBDA_M, found.max_theta_deg, found.max_phi_deg)
    assert found.max_gain_dbi == pytest.approx(float(towards_dbi), abs=1e-9)


def test_images_account_for_half_of_the_power():
    """The average over the sphere is 1 whatever the height: nothing is lost in a perfect conductor."""
    for height_m in (1.0, 4.0, 9.0):
        array = perturbed(np.random.default_rng(9), LAMBDA_M, tilt_rad=0.6)
        raised = Snapshot(array.centres_m + np.array([0.0, 0.0, height_m]), array.rotations, array.voltages)
        found = hertzian_pattern(raised, LAMBDA_M, grid_deg=5.0, image=True)
        assert found.average_gain == pytest.approx(1.0, abs=1e-6)


def test_a_dipole_on_the_ground_has_twice_the_gain():
    """A vertical dipole on the ground has 3 = 4.77 dBi along it: twice the field, half the sphere."""
    array = upright(np.array([[0.0, 0.0, 1e-3]]), np.ones(1, complex))
    found = hertzian_pattern(array, LAMBDA_M, grid_deg=5.0, image=True)
    assert found.max_gain_dbi == pytest.approx(10.0 * np.log10(3.0), abs=1e-4)


def test_disorder_has_the_requested_deviation_and_depends_only_on_the_seed():
    places_m = grid(8, 4, 8.5, 2.5)
    disorder = Disorder(sigma_m=0.4, tilt_rad=0.2, seed=3)
    found = list(islice(draws(places_m, CONFIG, disorder), 500))
    offsets_m = np.array([one.centres_m for one in found]) - places_m
    # a standard deviation of N draws scatters by 1 / sqrt(2 N); N = 4000 an axis
    assert offsets_m.std(axis=(0, 1)) == pytest.approx(np.full(3, 0.4), rel=4.0 / np.sqrt(8000.0))
    tilts_rad = np.arccos([one.axes[:, 2] for one in found])
    # two independent components of 0.2: the mean square of the tilt is twice theirs
    assert np.mean(tilts_rad**2) == pytest.approx(2.0 * 0.2**2, rel=4.0 / np.sqrt(4000.0))
    again = next(draws(places_m, CONFIG, Disorder(sigma_m=0.8, tilt_rad=0.2, seed=3)))
    np.testing.assert_array_equal(again.rotations, found[0].rotations)
    np.testing.assert_allclose(again.centres_m - places_m, 2.0 * offsets_m[0])
    other = next(draws(places_m, CONFIG, Disorder(sigma_m=0.4, tilt_rad=0.2, seed=4)))
    assert np.abs(other.centres_m - found[0].centres_m).max() > 0.1


@pytest.mark.parametrize(
    ("wavelength_m", "sigma_m", "mean_dbi", "std_db"),
    [(5.0, 0.5, 11.04, 0.86), (10.0, 0.5, 12.62, 0.28), (20.0, 1.0, 12.62, 0.28), (5.0, 1.0, 8.42, 1.05)],
)
def test_gain_falls_with_displacement_over_wavelength(capsys, wavelength_m, sigma_m, mean_dbi, std_db):
    """By NEC2 with 1000 draws on a 2 degree grid, which misses up to 0.05 dB of a maximum.

    Means scatter by std / sqrt(K); standard deviations by less, std / sqrt(2 K) of normal gains.
    """
    k = 600
    found = _run(
        capsys, f"statistics --sigma {sigma_m} --wavelength {wavelength_m} --samples {k} --cores 1 --seed 11"
    )
    scatter_db = std_db * np.sqrt(1.0 / k + 1.0 / 1000.0)
    assert found["mean_dbi"] == pytest.approx(mean_dbi, abs=0.05 + 2.0 * scatter_db)
    assert found["std_db"] == pytest.approx(std_db, abs=0.05 + 2.0 * scatter_db)
    assert (found["samples"], found["missing"]) == (k, 0)
    assert found["ideal_dbi"] == pytest.approx(13.262, abs=0.001)
    assert found["towards"]["mean_dbi"] < found["mean_dbi"] < found["ideal_dbi"]
    assert found["quantiles"]["0.05"] < found["quantiles"]["0.5"] < found["quantiles"]["0.95"]
    assert 0.0 < found["pointing"]["mean_deg"] < found["pointing"]["max_deg"]


def test_optimum_weights_for_true_positions_restore_the_gain(capsys):
    """13.45 dBi on average, and phases alone from true positions 12.35."""
    common = "statistics --sigma 0.5 --wavelength 10 --samples 200 --cores 1 --feeds truth"
    assert _run(capsys, f"{common} --excitation optimum")["mean_dbi"] == pytest.approx(13.45, abs=0.09)
    assert _run(capsys, common)["mean_dbi"] == pytest.approx(12.35, abs=0.12)


def test_statistics_do_not_depend_on_the_cores_and_write_files(capsys, tmp_path):
    command = f"statistics --sigma 1 --wavelength 5 --tilt 20 --samples 150 --netcdf {tmp_path}/n/p.nc"
    one = _run(capsys, f"{command} --cores 1 --figure {tmp_path}/d.png --envelope {tmp_path}/e.png")
    assert one == _run(capsys, f"{command} --cores 2")
    maxima_dbi = xr.load_dataset(tmp_path / "n" / "p.nc", engine="h5netcdf")["max_gain_dbi"].values
    assert maxima_dbi.mean() == pytest.approx(one["mean_dbi"])
    assert all((tmp_path / name).read_bytes().startswith(PNG) for name in ("d.png", "e.png"))


def test_samples_that_touch_are_counted_and_named(capsys):
    """Columns 0.4 m apart and dipoles of 5 m that lean: some cross."""
    found = _run(
        capsys,
        "statistics --formation 2x1 --broadside 0.04 --sigma 0.2 --tilt 15 --samples 60 --cores 1"
        " --length 5 --radius 0.02 --segments 11",
    )
    assert 0 < found["missing"] < 60
    assert "elements 0 and 1 touch" in found["first_missing"]


@pytest.mark.parametrize("excitation", ["end_fire", "optimum"])
def test_touching_ideal_formation_does_not_prevent_statistics(capsys, tmp_path, excitation):
    """All places are one: what is drawn around it, 2 m about, is apart."""
    common = f"--formation 2x1 --broadside 0 --sigma 2 --feeds truth --excitation {excitation} --seed 4"
    files = f"--figure {tmp_path}/d.png --envelope {tmp_path}/e.png"
    found = _run(capsys, f"statistics {common} --samples 20 --cores 1 {files}")
    assert found["ideal_dbi"] is None
    assert found["missing"] < 20
    one = _run(capsys, f"pattern {common} --figure {tmp_path}/p.png --cuts {tmp_path}/c.png")
    assert 1.0 < one["max_gain_dbi"] < 8.0
    names = [f"{name}.png" for name in "depc"]
    assert all((tmp_path / name).read_bytes().startswith(PNG) for name in names)


def test_ambiguous_maximum_has_no_pointing_error(capsys):
    assert _run(capsys, "pattern --formation 1x1")["pointing_error_deg"] is None
    assert _run(capsys, "pattern --formation 2x1")["pointing_error_deg"] is None  # as high along -y
    assert _run(capsys, "pattern --formation 1x2")["pointing_error_deg"] == pytest.approx(0.0, abs=0.1)


def test_lot_size_follows_from_the_size_of_a_pattern(capsys, monkeypatch):
    """A grid of 5 degrees in two polarisations is 2 * 37 * 72 * 4 bytes."""
    lots = []

    def recorded(config, *, threads=1):
        backend = make_backend(config, threads=threads)
        solve = backend.patterns
        backend.patterns = lambda snapshots: lots.append(len(snapshots)) or solve(snapshots)
        return backend

    monkeypatch.setattr(runs, "make_backend", recorded)
    command = "statistics --formation 2x2 --sigma 1 --samples 10 --cores 1"
    whole = _run(capsys, command)
    assert lots == [1, 10]
    lots.clear()
    monkeypatch.setattr(runs, "LOT_BYTES", 3 * 2 * 37 * 72 * 4 + 1)
    assert _run(capsys, command) == whole
    assert lots == [1, 3, 3, 3, 1]
    lots.clear()
    monkeypatch.setattr(runs, "LOT_BYTES", 1)
    _run(capsys, command)
    assert lots == [1] * 11


def test_out_of_memory_is_reported_in_one_line(capsys, monkeypatch):
    def greedy(*_args, **_kwargs):
        raise MemoryError("Unable to allocate 9.66 GiB for an array\nwith shape (1801, 3600, 400)")

    monkeypatch.setattr(runs, "one_pattern", greedy)
    assert main(["pattern"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("coflight: out of memory")
    assert "9.66 GiB" in said
    assert said.count("\n") == 1


def test_pattern_command_writes_figures_deck_and_data(capsys, tmp_path):
    command = f"pattern --sigma 0.5 --tilt 10 --seed 2 --figure {tmp_path}/p.png --cuts {tmp_path}/c.png"
    found = _run(capsys, f"{command} --deck-out {tmp_path}/p.nec --netcdf {tmp_path}/p.nc")
    assert all((tmp_path / name).read_bytes().startswith(PNG) for name in ("p.png", "c.png"))
    cards = [line.split() for line in (tmp_path / "p.nec").read_text().splitlines()]
    assert [len([card for card in cards if card[0] == kind]) for kind in ("GW", "EX", "RP", "EN")] == [
        8,
        8,
        1,
        1,
    ]
    assert (
        float(xr.load_dataset(tmp_path / "p.nc", engine="h5netcdf")["max_gain_dbi"][0])
        == found["max_gain_dbi"]
    )
    assert found["exact_directivity_dbi"] == pytest.approx(found["max_gain_dbi"] + NEC_BIAS_DB, abs=0.003)


def test_deck_defines_an_element(capsys, tmp_path):
    """The default dipole, written as a deck."""
    (tmp_path / "e.nec").write_text("GW 1 9 0 0 -0.025 0 0 0.025 0.0002\nGE 0\nEX 0 1 5 0 1 0\nEN\n")
    found = _run(capsys, f"pattern --deck {tmp_path}/e.nec")
    assert found["max_gain_dbi"] == pytest.approx(_run(capsys, "pattern")["max_gain_dbi"], abs=1e-6)
    assert found["exact_directivity_dbi"] is None


def test_default_output_is_a_table(capsys):
    assert main(["pattern", "--formation", "2x1"]) == 0
    printed = capsys.readouterr().out
    assert "max_gain_dbi" in printed
    assert "2x1, wavelength 10 m, batch" in printed


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("pattern --formation 4y2", "--formation: '4y2' is not a formation; expected COLUMNSxROWS"),
        ("pattern --formation 0x2", "--formation: 0x2 has 0 elements; expected 1 to 200"),
        ("pattern --formation 99x99", "--formation: 99x99 has 9801 elements"),
        ("pattern --backend nec5", "'--backend'"),
        ("pattern --wavelength 0", "--wavelength: Expected `float` > 0.0, not 0.0"),
        ("pattern --wavelength nan", "--wavelength: "),
        ("pattern --sigma nan", "'--sigma'"),
        ("pattern --sigma -1", "'--sigma'"),
        ("pattern --segments 8", "--segments: 8 is even"),
        ("pattern --radius 0.01", "--radius: a segment is 0.6 radii long"),
        ("pattern --grid 0", "--grid: "),
        ("pattern --ground real", "--backend: batch does not support real ground"),
        ("pattern --ground perfect", "element 0 touches the ground"),
        ("pattern --broadside 0", "elements 0 and 1 touch"),
        ("pattern --formation 4x1 --excitation hansen_woodyard", "two rows or more"),
        ("pattern --element deck", "--deck FILE"),
        ("pattern --deck {tmp}/none.nec", "none.nec: No such file"),
        ("pattern --deck {tmp}/bad.nec", "bad.nec: line 2: card 'LD' is not supported"),
        ("pattern --deck {tmp}/good.nec --element loop", "needs --element deck, not loop"),
        ("pattern --deck {tmp}/good.nec --length 2", "--length: not allowed with --deck {tmp}/good.nec"),
        ("pattern --deck {tmp}/good.nec --segments 9", "--segments: not allowed with --deck {tmp}/good.nec"),
        ("statistics --deck {tmp}/good.nec --radius 0.001", "--radius: not allowed with --deck {tmp}/"),
        ("pattern --permittivity 5", "--permittivity: only for real ground"),
        ("pattern --ground perfect --height 9 --conductivity 1", "--conductivity: only for real ground"),
        ("pattern --figure {tmp}/bad.nec/x.png", "bad.nec"),
        ("pattern --ground real --backend nec2 --height 5 --excitation optimum", "not support real ground"),
        ("pattern --ground perfect --height 5 --excitation optimum --element loop --length 1", "along +y"),
        ("statistics --samples 0", "'--samples'"),
        ("statistics --samples 900000 --netcdf {tmp}/a.nc", "--netcdf: 900000 patterns are 19.2 GB"),
        ("statistics --grid 0.1 --envelope {tmp}/e.png", "--envelope: histograms of 0.1 degrees are 10.4 GB"),
        ("statistics --formation 2x1 --broadside 0.00002 --samples 3", "elements 0 and 1 touch"),
        ("statistics --formation 9x9 --ground perfect --height 1 --sigma 9 --samples 3", "no sample has a"),
        ("benchmark --seconds -1", "'--seconds'"),
        ("pattern --what", "--what"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(capsys, tmp_path, command, said):
    (tmp_path / "bad.nec").write_text("GW 1 9 0 0 -1 0 0 1 0.001\nLD 4 0 0 0 50 0 0\nGE 0\nEN\n")
    (tmp_path / "good.nec").write_text("GW 1 9 0 0 -1 0 0 1 0.001\nGE 0\nEX 0 1 5 0 1 0\nEN\n")
    status = main(command.format(tmp=tmp_path).split())
    printed = capsys.readouterr()
    assert (status, printed.out) == (2, "")
    assert printed.err.startswith("coflight: ")
    assert printed.err.count("\n") == 1
    assert said.format(tmp=tmp_path) in printed.err


@pytest.mark.nec2
def test_benchmark_times_are_consistent(capsys):
    pytest.importorskip("PyNEC")
    found = _run(capsys, "benchmark --seconds 0")
    assert (found["elements"], found["directions"], found["rounds"]) == (8, 37 * 72, 3)
    for kind, name in (("short_dipole", "speedup_short_dipole"), ("dipole_5m", "speedup_5m_dipole")):
        speed = found[kind]
        assert found[name] == speed["speedup"] == pytest.approx(speed["nec2_us"] / speed["batch_us"])
        parts_us = speed["batch_solve_us"] + speed["batch_far_field_us"]
        assert speed["batch_grid_only_us"] == pytest.approx(parts_us)
        # far below what is promised: only that the clock runs around the right things
        assert speed["speedup"] > 10.0
        assert speed["speedup_grid_only"] > 10.0
    assert found["speedup_two_cores"] > 0.0

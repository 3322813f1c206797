import h5py
import msgspec
import numpy as np
import pytest
import xarray as xr
from antenna_arrays import perturbed
from antenna_hertzian import exact_patterns

from antenna.analysis.dataset import to_dataset, write_dataset
from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTooNear, ElementsTouch

CONFIG = AntennaConfig(wavelength_m=10.0, ground="perfect", excitation="optimum")


def _results(count=3):
    rng = np.random.default_rng(1)
    patterns = exact_patterns([perturbed(rng, 10.0) for _ in range(count)], 10.0)
    missing = ElementsTouch(4, -1, -0.1), ElementsTooNear(1, 6, 0.03)
    return [patterns[0], ElementsTouch(2, 5, 0.0003), *patterns[1:], *missing]


def _contains(dataset, results):
    """Compare rows with results, grids in single precision: below 1e-5 dB for 60 dB."""
    assert len(dataset["too_near"]) == len(results)
    for k, expected in enumerate(results):
        row = dataset.isel({dataset["too_near"].dims[0]: k})
        first, second = int(row["touching_first"]), int(row["touching_second"])
        if isinstance(expected, ElementsTouch):
            assert (first, second) == (expected.first, expected.second)
            assert float(row["touching_distance_m"]) == expected.distance_m
            assert bool(row["too_near"]) is isinstance(expected, ElementsTooNear)
            continue
        assert (first, second) == (-1, -1)
        for name in ("max_gain_dbi", "max_theta_deg", "max_phi_deg", "average_gain"):
            assert float(row[name]) == getattr(expected, name)
        for name, angles_deg in (("theta", expected.theta_deg), ("phi", expected.phi_deg)):
            np.testing.assert_array_equal(row[name], angles_deg)
        for name, gain_dbi in (
            ("gain_theta_dbi", expected.theta_gain_dbi),
            ("gain_phi_dbi", expected.phi_gain_dbi),
        ):
            np.testing.assert_allclose(row[name], gain_dbi, rtol=2.0**-24)


@pytest.mark.parametrize("timed", [False, True])
def test_dataset_round_trips_through_a_file(tmp_path, timed):
    results = _results()
    time_us = np.arange(len(results), dtype=np.int64) * 500_000 if timed else None
    dataset = to_dataset(results, CONFIG, accuracy="exact", time_us=time_us)
    write_dataset(dataset, tmp_path / "patterns.nc")
    found = xr.load_dataset(tmp_path / "patterns.nc", engine="h5netcdf")
    xr.testing.assert_identical(found, dataset)
    _contains(found, results)
    assert msgspec.json.decode(found["settings"].item(), type=AntennaConfig) == CONFIG
    assert list(found["gain_theta_dbi"].dims) == ["time" if timed else "sample", "theta", "phi"]
    if timed:
        np.testing.assert_array_equal(found["time"], time_us)
    assert [file.name for file in tmp_path.iterdir()] == ["patterns.nc"]


def test_dataset_file_has_labels_readable_by_hdf5(tmp_path):
    write_dataset(to_dataset(_results(), CONFIG, accuracy="exact"), tmp_path / "patterns.nc")
    with h5py.File(tmp_path / "patterns.nc") as file:
        grids = file["gain_theta_dbi"]
        assert (grids.shape, grids.dtype, grids.compression) == ((6, 37, 72), np.float32, "gzip")
        assert file["max_gain_dbi"].attrs["units"] == "dBi"
        assert file.attrs["backend"] == "exact"
        assert file.attrs["wavelength_m"] == 10.0
        assert file.attrs["ground"].startswith("perfect")
        assert "y end-fire" in file.attrs["frame"]
        assert np.isnan(grids[1]).all()  # those that touch have no gains
        assert file["touching_second"][:].tolist() == [-1, 5, -1, -1, -1, 6]
        assert file["touching_first"][:].tolist() == [-1, 2, -1, -1, 4, 1]
        assert file["too_near"][:].tolist() == [0, 0, 0, 0, 0, 1]


def test_directions_can_be_selected_by_label():
    pattern, *_ = results = _results()
    dataset = to_dataset(results, CONFIG, accuracy="exact")
    found = dataset["gain_theta_dbi"].sel(sample=0, theta=90.0, phi=45.0)
    assert float(found) == pytest.approx(pattern.theta_gain_dbi[18, 9], rel=1e-6)


def test_failed_write_keeps_the_existing_file(tmp_path, monkeypatch):
    path = tmp_path / "patterns.nc"
    path.write_bytes(b"before")
    dataset = to_dataset(_results(), CONFIG, accuracy="exact")

    def fail(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(OSError, match="No space"):
        write_dataset(dataset, path)
    assert path.read_bytes() == b"before"
    assert [file.name for file in tmp_path.iterdir()] == ["patterns.nc"]


def test_missing_folder_is_reported_with_the_path(tmp_path):
    path = tmp_path / "nowhere" / "patterns.nc"
    with pytest.raises(FileNotFoundError) as caught:
        write_dataset(to_dataset(_results(), CONFIG, accuracy="exact"), path)
    assert caught.value.filename == str(path)


def test_invalid_results_are_rejected():
    rng = np.random.default_rng(1)
    coarse, fine = (exact_patterns([perturbed(rng, 10.0)], 10.0, step)[0] for step in (10.0, 5.0))
    assert isinstance(coarse, Pattern)
    with pytest.raises(ValueError, match="same grid"):
        to_dataset([coarse, fine], CONFIG, accuracy="exact")
    with pytest.raises(ValueError, match="no pattern"):
        to_dataset([ElementsTouch(0, 1, 0.0)], CONFIG, accuracy="exact")
    with pytest.raises(ValueError, match="time_us"):
        to_dataset([coarse], CONFIG, accuracy="exact", time_us=np.array([1, 2]))

import h5py
import numpy as np
import pytest
import xarray as xr
from antenna_arrays import perturbed
from antenna_hertzian import exact_patterns

from antenna.analysis.dataset import (
    NotPatterns,
    from_dataset,
    read_dataset,
    settings_of,
    to_dataset,
    write_dataset,
)
from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTooNear, ElementsTouch

CONFIG = AntennaConfig(wavelength_m=10.0, ground="perfect", excitation="optimum")


def _results(count=3):
    rng = np.random.default_rng(1)
    patterns = exact_patterns([perturbed(rng, 10.0) for _ in range(count)], 10.0)
    missing = ElementsTouch(4, -1, -0.1), ElementsTooNear(1, 6, 0.03)
    return [patterns[0], ElementsTouch(2, 5, 0.0003), *patterns[1:], *missing]


def _same(found, wanted):
    """Equal but for single precision: a part in 2^24 of 60 dB is less than 1e-5 dB."""
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        assert type(one) is type(other)
        if isinstance(other, ElementsTouch):
            assert (one.first, one.second, one.distance_m) == (other.first, other.second, other.distance_m)
            assert str(one) == str(other)
            continue
        for name in ("max_gain_dbi", "max_theta_deg", "max_phi_deg", "average_gain", "backend"):
            assert getattr(one, name) == getattr(other, name)
        for name in ("theta_deg", "phi_deg"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        for name in ("theta_gain_dbi", "phi_gain_dbi"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=2.0**-24)
        seen = other.gain_dbi > -60.0
        np.testing.assert_allclose(one.gain_dbi[seen], other.gain_dbi[seen], atol=1e-5)


@pytest.mark.parametrize("timed", [False, True])
def test_results_come_back_from_a_file(tmp_path, timed):
    results = _results()
    time_us = np.arange(len(results), dtype=np.int64) * 500_000 if timed else None
    dataset = to_dataset(results, CONFIG, accuracy="exact", time_us=time_us)
    write_dataset(dataset, tmp_path / "patterns.nc")
    found = read_dataset(tmp_path / "patterns.nc")
    xr.testing.assert_identical(found, dataset)
    _same(from_dataset(found), results)
    assert settings_of(found) == CONFIG
    assert list(found["gain_theta_dbi"].dims) == ["time" if timed else "sample", "theta", "phi"]
    if timed:
        np.testing.assert_array_equal(found["time"], time_us)
    assert [file.name for file in tmp_path.iterdir()] == ["patterns.nc"]


def test_a_file_explains_itself_to_any_hdf5_tool(tmp_path):
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


def test_labels_find_directions():
    pattern, *_ = results = _results()
    dataset = to_dataset(results, CONFIG, accuracy="exact")
    found = dataset["gain_theta_dbi"].sel(sample=0, theta=90.0, phi=45.0)
    assert float(found) == pytest.approx(pattern.theta_gain_dbi[18, 9], rel=1e-6)


def test_a_file_that_cannot_be_written_leaves_what_was_there(tmp_path, monkeypatch):
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


def test_a_folder_that_is_not_there_is_named_by_the_file(tmp_path):
    path = tmp_path / "nowhere" / "patterns.nc"
    with pytest.raises(FileNotFoundError) as caught:
        write_dataset(to_dataset(_results(), CONFIG, accuracy="exact"), path)
    assert caught.value.filename == str(path)


def test_other_files_are_refused_in_one_line(tmp_path):
    text, other = tmp_path / "a.txt", tmp_path / "b.nc"
    text.write_text("gain")
    xr.Dataset({"gain_theta_dbi": ("sample", [1.0])}).to_netcdf(other, engine="h5netcdf")
    for path, reason in ((text, "not a NetCDF-4 file"), (other, "not patterns")):
        with pytest.raises(NotPatterns, match=reason) as caught:
            read_dataset(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError):
        read_dataset(tmp_path / "none.nc")


def test_what_belongs_to_no_dataset_is_refused():
    rng = np.random.default_rng(1)
    coarse, fine = (exact_patterns([perturbed(rng, 10.0)], 10.0, step)[0] for step in (10.0, 5.0))
    assert isinstance(coarse, Pattern)
    with pytest.raises(ValueError, match="same grid"):
        to_dataset([coarse, fine], CONFIG, accuracy="exact")
    with pytest.raises(ValueError, match="no pattern"):
        to_dataset([ElementsTouch(0, 1, 0.0)], CONFIG, accuracy="exact")
    with pytest.raises(ValueError, match="time_us"):
        to_dataset([coarse], CONFIG, accuracy="exact", time_us=np.array([1, 2]))

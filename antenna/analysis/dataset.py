"""Convert patterns to one labelled dataset, and write it as a NetCDF-4 file.

A row is one instant of a flight (``time``) or one draw (``sample``). A row whose elements touch, or are too
near for a solution, has gains of NaN and the indices of these elements. Attributes describe the solver, its
accuracy, the antenna and the meaning of the numbers.
"""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from antenna.analysis.patterns import FLOOR_DBI, Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTooNear, ElementsTouch

FORMAT = "coflight antenna patterns 2"
NO_ELEMENT = -1
COMPRESSION = {"zlib": True, "complevel": 4, "shuffle": True}
_MAXIMUM = {
    "max_gain_dbi": ("dBi", "greatest gain of all directions, refined beyond the grid"),
    "max_theta_deg": ("degree", "theta of the greatest gain"),
    "max_phi_deg": ("degree", "phi of the greatest gain"),
    "average_gain": ("1", "radiated over input power, linear; gain over this is directivity"),
}
_GRIDS = {
    "gain_theta_dbi": ("dBi", "gain over input power in the theta polarisation, vertical at the horizon"),
    "gain_phi_dbi": ("dBi", "gain over input power in the phi polarisation, horizontal"),
}


def to_dataset(
    results: Sequence[Pattern | ElementsTouch], config: AntennaConfig, *, accuracy: str,
    time_us: NDArray[np.int64] | None = None,
) -> xr.Dataset:  # fmt: skip
    """Return results as a dataset, in order; rows are samples, or with ``time_us`` (K,) instants.

    Raises ValueError if there is no pattern, or their grids differ.
    """
    patterns = [result for result in results if isinstance(result, Pattern)]
    if not patterns:
        raise ValueError("no pattern to store: elements touch in all results")
    first, row = patterns[0], "sample" if time_us is None else "time"
    shape = first.theta_gain_dbi.shape
    if any(pattern.theta_gain_dbi.shape != shape for pattern in patterns):
        raise ValueError("all patterns of a dataset must have the same grid")
    grids = np.full((2, len(results), *shape), np.nan, np.float32)
    maxima = np.full((len(_MAXIMUM), len(results)), np.nan)
    touching = np.full((2, len(results)), NO_ELEMENT, np.int32)
    too_near = np.zeros(len(results), np.int8)
    distance_m = np.full(len(results), np.nan)
    for k, result in enumerate(results):
        if isinstance(result, Pattern):
            grids[:, k] = result.theta_gain_dbi, result.phi_gain_dbi
            maxima[:, k] = result.max_gain_dbi, result.max_theta_deg, result.max_phi_deg, result.average_gain
        else:
            touching[:, k], distance_m[k] = (result.first, result.second), result.distance_m
            too_near[k] = isinstance(result, ElementsTooNear)
    of_two = "of the two elements that touch, from 0; -1: none"
    variables = {
        **{name: ((row, "theta", "phi"), grids[i], _about(*_GRIDS[name])) for i, name in enumerate(_GRIDS)},
        **{name: (row, maxima[i], _about(*_MAXIMUM[name])) for i, name in enumerate(_MAXIMUM)},
        "touching_first": (row, touching[0], {"long_name": f"first {of_two}"}),
        "touching_second": (row, touching[1], {"long_name": f"second {of_two}, or the ground"}),
        "touching_distance_m": (row, distance_m, _about("m", "between the axes of what touches")),
        "too_near": (
            row, too_near, {"long_name": "1: the two do not touch, but are too near for a solution; 0: else"},
        ),
        "settings": (
            (), msgspec.json.encode(config).decode(), {"long_name": "the [antenna] table, as JSON"},
        ),
    }  # fmt: skip
    about_phi = _about("degree", "from +x (broadside axis) towards +y (end-fire axis)")
    coordinates = {
        "theta": ("theta", first.theta_deg, _about("degree", "from +z (up)")),
        "phi": ("phi", first.phi_deg, about_phi),
        row: (row, *_rows(len(results), time_us)),
    }
    attributes = {
        "format": FORMAT,
        "Conventions": "CF-1.11",
        "title": "Power gain of a swarm's synthetic aperture",
        "backend": first.backend,
        "accuracy": str(accuracy),
        "wavelength_m": config.wavelength_m,
        "element": describe_element(config),
        "ground": describe_ground(config),
        "excitation": config.excitation,
        "feeds_for": config.feeds_for,
        "frame": "x broadside, y end-fire, z up; theta from +z, phi from +x towards +y",
        "gain": f"over input power, dBi; {FLOOR_DBI} where nothing is radiated, NaN where elements touch",
    }
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write a NetCDF-4 file atomically; its folder must exist. Raises OSError."""
    encoding = {name: {**COMPRESSION, "chunksizes": _chunk(dataset[name])} for name in _GRIDS}
    try:
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    os.close(descriptor)
    try:
        dataset.to_netcdf(name, engine="h5netcdf", format="NETCDF4", encoding=encoding)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink()
        raise


def describe_element(config: AntennaConfig) -> str:
    """Return a one-line description of the element."""
    if config.element_kind == "deck":
        wires = config.element().wires
        return f"NEC deck, {len(wires)} wires, {sum(wire.segments for wire in wires)} segments"
    around = "length" if config.element_kind == "dipole" else "circumference"
    return (
        f"{config.element_kind}, {around} {config.element_length_m:g} m, wire radius"
        f" {config.element_radius_m:g} m, {config.segments} segments"
    )


def describe_ground(config: AntennaConfig) -> str:
    """Return a one-line description of the ground."""
    if config.ground != "real":
        return {"none": "none: free space", "perfect": "perfect, at z = 0"}[config.ground]
    return (
        f"real, at z = 0: relative permittivity {config.ground_permittivity:g},"
        f" conductivity {config.ground_conductivity_s_m:g} S/m"
    )


def _about(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}


def _rows(count: int, time_us: NDArray[np.int64] | None) -> tuple[NDArray[np.int64], dict[str, str]]:
    if time_us is None:
        return np.arange(count), {"long_name": "draw"}
    if time_us.shape != (count,):
        raise ValueError(f"time_us: expected shape ({count},), not {time_us.shape}")
    # CF time coordinates have a unit "since" an epoch; simulated time has no epoch
    return time_us.astype(np.int64), {"long_name": "simulated time", "unit_of_time": "us"}


def _chunk(grids: xr.DataArray) -> tuple[int, int, int]:
    """Return the chunk size: whole patterns, about 1 MB."""
    rows, theta, phi = grids.shape
    return max(1, min(rows, 262_144 // (theta * phi))), theta, phi

"""Reads a grid of path gains from a NetCDF file; the only place of the radio that imports xarray."""

from pathlib import Path

import numpy as np
import xarray as xr
from msgspec import Struct

from netsim.phy.path_loss import Doubles

AXES = ("east_m", "north_m", "up_m")
GAIN = "path_gain_db"
TRANSMITTER = "transmitter"


class GridFile(Struct, frozen=True, kw_only=True):
    """Path gains from k transmitters to the points of a grid."""

    axes_m: tuple[Doubles, Doubles, Doubles]
    """Increasing coordinates of the points, east (x,), north (y,) and up (z,)."""
    gains_db: Doubles
    """(k, x, y, z); NaN or minus infinity where there is no path."""
    transmitters_m: Doubles
    """(k, 3) east, north, up."""
    frequency_mhz: float | None
    """None: the file does not state it."""


def read_grid(path: Path) -> GridFile:
    """Return the content of a file. Raises ValueError with one line that names it."""
    try:
        with xr.open_dataset(path, decode_times=False) as dataset:
            return _grid(dataset.load())
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no such file") from None
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{path}: not NetCDF: {' '.join(str(error).split())}") from None
    except ValueError as error:
        reason = str(error).splitlines()[0]
        if reason.startswith("did not find a match in any of xarray's"):
            reason = "not NetCDF"
        raise ValueError(f"{path}: {reason}") from None


def _grid(dataset: xr.Dataset) -> GridFile:
    for name in (GAIN, *AXES, *(f"{TRANSMITTER}_{axis}" for axis in AXES)):
        if name not in dataset.variables:
            raise ValueError(
                f"no variable {name}; expected {GAIN}, {', '.join(AXES)} and transmitter_ of each"
            )
    gains = dataset[GAIN]
    if TRANSMITTER not in gains.dims:
        gains = gains.expand_dims(TRANSMITTER)
    if set(gains.dims) != {TRANSMITTER, *AXES}:
        raise ValueError(f"{GAIN} has the dimensions {gains.dims}; expected {(TRANSMITTER, *AXES)}")
    gains = gains.transpose(TRANSMITTER, *AXES)
    axes_m = [np.asarray(dataset[axis], np.float64) for axis in AXES]
    for name, axis_m in zip(AXES, axes_m, strict=True):
        increasing = axis_m.ndim == 1 and len(axis_m) >= 2 and (np.diff(axis_m) > 0.0).all()
        if not (increasing and np.isfinite(axis_m).all()):
            raise ValueError(f"{name}: expected at least two increasing, finite coordinates")
    places = [np.atleast_1d(np.asarray(dataset[f"{TRANSMITTER}_{axis}"], np.float64)) for axis in AXES]
    if not len(gains) or any(place.shape != (len(gains),) for place in places):
        raise ValueError(
            f"transmitter_east_m and others: expected one value for each of {max(len(gains), 1)} transmitters"
        )
    transmitters_m = np.stack(places, axis=1)
    if not np.isfinite(transmitters_m).all():
        raise ValueError("transmitter_east_m and others: expected finite coordinates")
    gains_db = np.asarray(gains, np.float64)
    if not np.isfinite(gains_db).any():
        raise ValueError(f"{GAIN}: no point has a path; expected gains in dB")
    return GridFile(
        axes_m=(axes_m[0], axes_m[1], axes_m[2]),
        gains_db=gains_db,
        transmitters_m=transmitters_m,
        frequency_mhz=_frequency_mhz(dataset.attrs.get("frequency_mhz")),
    )


def _frequency_mhz(attribute: object) -> float | None:
    if attribute is None:
        return None
    try:
        return float(np.asarray(attribute, np.float64).reshape(()))
    except ValueError:
        raise ValueError(f"attribute frequency_mhz: {attribute!r}; expected a number") from None

"""Path loss from a three-dimensional grid of path gains, such as a ray tracer writes for some transmitters.

What is interpolated is the excess loss: the grid's loss minus that of free space over the same distance. It
varies slowly, whereas the gain has a peak at each transmitter that no grid resolves. The loss of a link is
that of free space over its own distance plus its excess loss.

The file has the excess loss e_k(p) from each transmitter t_k to every point p, by trilinear interpolation in
dB; outside the grid it is that of the nearest point of its surface. Both stations a, b of a link move, and
neither is at a transmitter in general. By reciprocity each transmitter gives two samples: e_k(b), which is
exact if a is at t_k, and e_k(a), exact if b is there. The excess loss of the link is the mean of all samples,
each weighted with 1 / (d^2 + `SMOOTHING_M`^2), where d is the distance |a - t_k| or |b - t_k| (Shepard, "A
two-dimensional interpolation function for irregularly-spaced data", 1968). So it is equal in both directions,
continuous, and that of the file for links that end at a transmitter. Between transmitters it is as good as
they are dense: with one transmitter, links whose ends are both far from it have the mean of two unrelated
shadows.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from scipy.interpolate import RegularGridInterpolator

from netsim.phy.interfaces import RadioContext
from netsim.phy.path_loss import REFERENCE_DISTANCE_M, Doubles, friis_loss_db
from netsim.radio_models.grid_file import read_grid

SMOOTHING_M = 0.1
"""Distance from a transmitter within which its samples prevail; it avoids infinite weights."""
FREQUENCY_TOLERANCE = 0.1
"""Relative difference of the file's frequency from the radio's up to which the excess loss is used."""


class GridSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the path loss ``grid``."""

    file: str
    """NetCDF file, relative to the scenario: ``path_gain_db`` over the dimensions ``transmitter`` (optional),
    ``east_m``, ``north_m``, ``up_m``, with coordinates in metres from the site's origin, and the positions
    ``transmitter_east_m``, ``transmitter_north_m``, ``transmitter_up_m``. An attribute ``frequency_mhz`` is
    compared with the radio's."""
    no_path_loss_db: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 60.0
    """Excess loss of points without a path, NaN or minus infinity in the file."""


class LossGrid:
    """Path loss of a grid; see the module and `netsim.phy.interfaces.PathLoss`."""

    Settings = GridSettings

    def __init__(self, radio: RadioContext, settings: GridSettings) -> None:
        path = radio.folder / settings.file
        try:
            grid = read_grid(path)
        except ValueError as error:
            raise ValueError(f"file: {error}") from None
        radio_mhz = radio.config.frequency_mhz
        file_mhz = radio_mhz if grid.frequency_mhz is None else grid.frequency_mhz
        if not abs(file_mhz - radio_mhz) <= FREQUENCY_TOLERANCE * radio_mhz:
            raise ValueError(
                f"file: {path}: it is for {file_mhz:g} MHz; radio.frequency_mhz is {radio_mhz:g}"
            )
        if (grid.gains_db > 0.0).any():
            raise ValueError(
                f"file: {path}: path gains of up to {np.nanmax(grid.gains_db):g} dB; expected losses"
            )
        self._reference_db = friis_loss_db(REFERENCE_DISTANCE_M, radio_mhz)
        self._transmitters_m = grid.transmitters_m
        self._low_m = np.array([axis_m[0] for axis_m in grid.axes_m])
        self._high_m = np.array([axis_m[-1] for axis_m in grid.axes_m])
        points_m = np.stack(np.meshgrid(*grid.axes_m, indexing="ij"), axis=-1)
        away_m = np.linalg.norm(points_m - grid.transmitters_m[:, None, None, None], axis=-1)
        free_db = friis_loss_db(REFERENCE_DISTANCE_M, file_mhz) + _spread_db(away_m)
        excess_db = np.where(np.isfinite(grid.gains_db), -grid.gains_db - free_db, settings.no_path_loss_db)
        self._last_ned_m: Doubles = np.empty((0, 3))
        self._last_samples: tuple[Doubles, Doubles]
        """Weights and excess losses of the last receivers."""
        self._excess_db = RegularGridInterpolator(grid.axes_m, np.moveaxis(excess_db, 0, -1))

    def loss_db(self, from_ned_m: Doubles, to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.PathLoss`."""
        if not np.array_equal(to_ned_m, self._last_ned_m):  # equal for the links of all sources at a time
            self._last_ned_m, self._last_samples = to_ned_m, self._samples(to_ned_m)
        to_weights, to_db = self._last_samples
        same = np.array_equal(from_ned_m, to_ned_m)
        from_weights, from_db = self._last_samples if same else self._samples(from_ned_m)
        sums = from_weights @ to_db.T + from_db @ to_weights.T
        weights = from_weights.sum(axis=1)[:, None] + to_weights.sum(axis=1)
        return np.asarray(np.maximum(self._reference_db + _spread_db(distance_m) + sums / weights, 0.0))

    def check_places(self, pos_ned_m: Doubles) -> None:
        """Check that the grid reaches the vehicles' places (n, 3). Raises ValueError if none is within it."""
        pos_enu_m = _enu_m(pos_ned_m)
        if not ((pos_enu_m >= self._low_m) & (pos_enu_m <= self._high_m))[:, :2].all(axis=1).any():
            (west, south, _), (east, north, _) = self._low_m.tolist(), self._high_m.tolist()
            raise ValueError(
                f"the grid has points from {west:g} to {east:g} m east and {south:g} to {north:g} m north, "
                "where no vehicle has its place; expected coordinates from the site's origin"
            )

    def _samples(self, pos_ned_m: Doubles) -> tuple[Doubles, Doubles]:
        """Return weights and excess losses in dB (n, k) of n positions and k transmitters."""
        pos_enu_m = _enu_m(pos_ned_m)
        away_m = pos_enu_m[:, None] - self._transmitters_m
        weights = 1.0 / (np.einsum("ijk,ijk->ij", away_m, away_m) + SMOOTHING_M**2)
        return weights, self._excess_db(np.clip(pos_enu_m, self._low_m, self._high_m))


def _enu_m(pos_ned_m: Doubles) -> Doubles:
    return np.asarray(pos_ned_m[:, (1, 0, 2)] * (1.0, 1.0, -1.0))


def _spread_db(distance_m: Doubles) -> Doubles:
    """Return the loss of free space relative to that at 1 m, dB."""
    return np.asarray(20.0 * np.log10(np.maximum(distance_m, REFERENCE_DISTANCE_M)))

"""The antenna's pattern at an instant as a surface around the array, in the site's frame (NED)."""

from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch
from antenna.solvers.interface import Backend
from antenna.solvers.selection import make_backend
from foundation.types import Array
from harness.records.flight import Flight
from harness.report.flown_array import NoFeed, antenna_from_ned, snapshot_at

FLOOR_DBI = -12.0
"""Gain at the surface's centre"""
GRID_DEG = 6.0


class Surface(NamedTuple):
    """A closed surface whose distance from the array's centre rises with the gain in dB."""

    vertices_ned_m: Array
    """(V, 3)"""
    triangles: NDArray[np.int64]
    """(F, 3) indices of vertices"""
    gain_dbi: Array
    """(V,)"""
    centre_ned_m: Array
    """(3,)"""
    lobe_ned_m: Array
    """(3,) from the centre to the surface in the direction of the maximum"""
    max_gain_dbi: float


def live_solver(config: AntennaConfig) -> Backend:
    """Return a solver for patterns in flight: the batch solver wherever it applies, on one thread.

    Raises `antenna.solvers.interface.BackendUnavailable`.
    """
    backend = config.backend if config.ground == "real" else "batch"
    return make_backend(msgspec.structs.replace(config, backend=backend, grid_deg=GRID_DEG))


def surface_at(flight: Flight, t: int, config: AntennaConfig, solver: Backend) -> Surface | None:
    """Return the surface at the flight's instant ``t``; None without a pattern."""
    try:
        (pattern,) = solver.patterns([snapshot_at(flight, t, config)])
    except (NoFeed, ElementsTouch):
        return None
    if isinstance(pattern, ElementsTouch):
        return None
    alive = flight.alive[t]
    places_ned_m = flight.pos_ned_m[t, alive]
    centre_ned_m = places_ned_m.mean(axis=0)
    apart_m = np.linalg.norm(places_ned_m - centre_ned_m, axis=1).max() if alive.any() else 0.0
    return make_surface(pattern, float(flight.heading_rad[t]), centre_ned_m, size_m=max(1.2 * apart_m, 2.0))


def make_surface(pattern: Pattern, heading_rad: float, centre_ned_m: Array, *, size_m: float) -> Surface:
    """Return the surface of a pattern, whose maximum has the distance ``size_m`` from the centre."""
    theta, phi = np.radians(pattern.theta_deg), np.radians(pattern.phi_deg)
    gain_dbi = pattern.gain_dbi
    radius_m = _radius_m(gain_dbi, pattern.max_gain_dbi, size_m)
    directions = _directions(theta[:, None], phi[None, :])
    to_ned = antenna_from_ned(heading_rad).T
    vertices_ned_m = centre_ned_m + (radius_m[..., None] * directions) @ to_ned.T
    rows, columns = gain_dbi.shape
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    right = (j + 1) % columns
    here, below = i * columns + j, (i + 1) * columns + j
    beside, across = i * columns + right, (i + 1) * columns + right
    triangles = np.concatenate(
        [np.stack([here, below, across], axis=-1), np.stack([here, across, beside], axis=-1)]
    ).reshape(-1, 3)
    lobe = _directions(np.radians(pattern.max_theta_deg), np.radians(pattern.max_phi_deg))
    return Surface(
        vertices_ned_m=vertices_ned_m.reshape(-1, 3),
        triangles=triangles,
        gain_dbi=gain_dbi.ravel(),
        centre_ned_m=centre_ned_m,
        lobe_ned_m=to_ned @ (size_m * lobe),
        max_gain_dbi=pattern.max_gain_dbi,
    )


def _directions(theta: Array, phi: Array) -> Array:
    """Return unit vectors (..., 3) in the antenna's frame."""
    components = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(components, axis=-1)


def _radius_m(gain_dbi: Array, max_gain_dbi: float, size_m: float) -> Array:
    span_db = max(max_gain_dbi - FLOOR_DBI, 1.0)
    radius_m: Array = size_m * np.clip((gain_dbi - FLOOR_DBI) / span_db, 0.0, 1.0)
    return radius_m

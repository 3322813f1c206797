"""Formations for the command line: the ideal one, and random ones with displaced and tilted vehicles."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, ElementsTouch, Snapshot, grid, upright
from antenna.solvers.ports import feed

DRAWN_TOGETHER = 256
MOST_ELEMENTS = 200
"""Most elements; the size of the equations grows with the square."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Disorder:
    """Random position and attitude errors of the vehicles: Gaussian, independent per vehicle and axis."""

    sigma_m: float = 0.0
    """Standard deviation of the position along x, y and z."""
    tilt_rad: float = 0.0
    """Standard deviation of the components of the rotation vector along x and y."""
    seed: int = 1


def formation(text: str, *, broadside_m: float, endfire_m: float, height_m: float) -> Array:
    """Return the positions (n, 3) of a grid ``AxB``: A columns along x, B rows along y; raises ValueError."""
    found = re.fullmatch(r"(\d{1,3})x(\d{1,3})", text)
    if found is None:
        raise ValueError(f"--formation: {text!r} is not a formation; expected COLUMNSxROWS, such as 4x2")
    columns, rows = (int(word) for word in found.groups())
    if not 1 <= columns * rows <= MOST_ELEMENTS:
        raise ValueError(f"--formation: {text} has {columns * rows} elements; expected 1 to {MOST_ELEMENTS}")
    places_m = grid(columns * rows, columns, broadside_m, endfire_m)
    places_m[:, 2] = height_m
    return places_m


def ideal(places_m: Array, config: AntennaConfig) -> Snapshot:
    """Return the snapshot with all vehicles upright at their places."""
    return upright(places_m, feed(places_m, config))


def draws(places_m: Array, config: AntennaConfig, disorder: Disorder) -> Iterator[Snapshot]:
    """Yield random formations without end; they depend only on the seed.

    Positions and tilts have separate streams, so that neither changes with the other's standard deviation.
    Feeds are computed for the places, or with ``feeds_for`` truth for the drawn positions and attitudes.
    Raises as `feed`, except for drawn elements that touch.
    """
    streams = np.random.SeedSequence(disorder.seed).spawn(2)
    positions, tilts = (np.random.default_rng(stream) for stream in streams)
    n = len(places_m)
    for_places = None if config.feeds_for == "truth" else feed(places_m, config)
    while True:
        centres_m = places_m + disorder.sigma_m * positions.standard_normal((DRAWN_TOGETHER, n, 3))
        turns_rad = np.zeros((DRAWN_TOGETHER, n, 3))
        turns_rad[..., :2] = disorder.tilt_rad * tilts.standard_normal((DRAWN_TOGETHER, n, 2))
        rotations = Rotation.from_rotvec(turns_rad.reshape(-1, 3)).as_matrix().reshape(-1, n, 3, 3)
        for centre_m, rotation in zip(centres_m, rotations, strict=True):
            voltages = for_places
            if voltages is None:
                try:
                    voltages = feed(centre_m, config, rotation, places_m=places_m)
                except ElementsTouch:  # the solver reports it too
                    voltages = np.ones(n, complex)
            yield Snapshot(centre_m, rotation, voltages)

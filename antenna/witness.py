"""What both NEC2 programs ask of a snapshot and of the pattern that they find, one at a time."""

import math

from antenna.clearance import GROUND, Nearest, credible, near_m, placed_wires_m, reach_m
from antenna.config import AntennaConfig
from antenna.elements import Element
from antenna.geometry import ElementsTooNear, Snapshot
from antenna.patterns import FLOOR_DBI, Pattern, directions_deg, times_finer

SMALL_RAD = 0.3
"""Elements that reach less of the wave's phase radiate so little that NEC2's ground errs."""
LEAST_HEIGHT_SMALL_LAMBDA = 0.49
"""Of their lowest point over real ground: from here on PyNEC and nec2c agree to 0.01 dB, at 0.3 to 0.8 dB,
and lower PyNEC's sources feed in negative power."""
LEAST_HEIGHT_LAMBDA = 0.25
"""The same of larger elements, for 0.05 dB."""


def grid_step_deg(config: AntennaConfig) -> float:
    """Step of the grid that is asked for, which divides the half circle."""
    theta_deg, _ = directions_deg(config.grid_deg)
    return float(theta_deg[1])


def solve_finer(snapshot: Snapshot, element: Element, config: AntennaConfig) -> int:
    """How many times finer than that the pattern is to be solved, see `times_finer`."""
    return times_finer(
        snapshot.centres_m,
        reach_m(element),
        config.wavelength_m,
        grid_step_deg(config),
        config.ground != "none",
    )


def check_height(snapshot: Snapshot, element: Element, config: AntennaConfig) -> None:
    """Raise `ElementsTooNear` for the lowest element if it is too low over real ground."""
    if config.ground != "real":
        return
    small = 2.0 * math.pi * reach_m(element) / config.wavelength_m < SMALL_RAD
    least_m = (LEAST_HEIGHT_SMALL_LAMBDA if small else LEAST_HEIGHT_LAMBDA) * config.wavelength_m
    heights_m = placed_wires_m(snapshot, element)[..., 2].min(axis=(1, 2))
    lowest = int(heights_m.argmin())
    if heights_m[lowest] < least_m:
        raise ElementsTooNear(lowest, GROUND, float(heights_m[lowest]))


def check_credible(pattern: Pattern, found: Nearest, config: AntennaConfig) -> None:
    """Raise `ElementsTooNear` for a pattern without power, or of elements near each other out of balance."""
    lossy = config.ground == "real"
    doubtful = lossy or found.distance_m < near_m(config.wavelength_m)
    balanced = credible(pattern.average_gain, lossy=lossy)
    if pattern.max_gain_dbi <= FLOOR_DBI or (doubtful and not balanced):
        raise ElementsTooNear(*found)

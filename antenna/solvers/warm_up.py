"""Run every compiled kernel of the antenna once, so that all are in the cache on disk.

The results are not used.
"""

import numpy as np

from antenna.analysis.patterns import Pattern
from antenna.model.clearance import NEAR_RAD, check_apart
from antenna.model.config import AntennaConfig
from antenna.model.geometry import grid, upright
from antenna.solvers.ports import feed
from antenna.solvers.selection import make_backend
from foundation.kernels.warm_up import WarmUpError

HEIGHT_M = 10.0


def warm_up() -> None:
    """Solve dipoles apart and near each other, in free space and over a ground. Raises WarmUpError."""
    for ground in ("none", "perfect"):
        config = AntennaConfig(ground=ground, excitation="optimum", grid_deg=30.0)
        places_m = grid(4, 2, 8.5, 2.5) + np.array([0.0, 0.0, HEIGHT_M])
        places_m[0] += 0.7  # so that the maximum is not in a direction of the grid
        near_m = grid(2, 2, 0.5 * NEAR_RAD * config.wavelength_m / (2.0 * np.pi), 0.0) + HEIGHT_M
        arrays = [upright(places_m, feed(places_m, config)) for places_m in (places_m, near_m)]
        check_apart(arrays[0], config.element(), grounded=ground == "perfect")
        for pattern in make_backend(config).patterns(arrays):
            if not isinstance(pattern, Pattern):
                raise WarmUpError(f"antenna warm-up: no pattern: {pattern}")

"""Growth of a measured quantity: a robust slope, of the part of a series after its start."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import theilslopes

WARM_UP = 0.25
"""Share of a series that is not judged: buffers and caches fill, and pages of forked processes are copied."""


def slope(places: Sequence[float], values: Sequence[float]) -> float:
    """Return the median slope of all pairs of measurements after the warm-up (Theil and Sen).

    Up to a quarter of the measurements may be outliers. Raises ValueError for fewer than four measurements.
    """
    if len(places) < 4:
        raise ValueError(f"{len(places)} measurements: a growth requires 4")
    first = int(WARM_UP * len(places))
    x, y = np.asarray(places, dtype=float)[first:], np.asarray(values, dtype=float)[first:]
    return float(theilslopes(y, x).slope)

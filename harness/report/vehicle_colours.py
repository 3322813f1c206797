"""Colours of the vehicles: the same in figures, in pages and in the viewer.

Those of MCAP files are others, since red and grey are states of a vehicle there (`harness.export.colours`).
"""

import numpy as np

_TEN = (
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f",
    "#bcbd22", "#17becf",
)  # fmt: skip
"""Matplotlib's colours C0 to C9"""


def vehicle_colours(count: int) -> list[str]:
    """Return the colour of each of ``count`` vehicles, as ``#rrggbb``."""
    if count <= len(_TEN):
        return list(_TEN[:count])
    from matplotlib import colormaps  # noqa: PLC0415  for large swarms only
    from matplotlib.colors import to_hex  # noqa: PLC0415  as above

    return [to_hex(rgba) for rgba in colormaps["turbo"](np.linspace(0.05, 0.95, count))]

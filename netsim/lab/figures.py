"""Figures of the radio measurements without a flight."""

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from netsim.lab.ranging import MeshResult


def mesh_figure(results: Sequence[MeshResult], *, period_s: float) -> Figure:
    """Plot completion, busy medium and delay of ranging between all pairs by number of stations."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    shares, delays = figure.subplots(2, 1, sharex=True)
    counts = [result.stations for result in results]
    shares.plot(counts, [r.airtime_fraction for r in results], "k--", label="airtime needed")
    shares.plot(counts, [r.completed_fraction for r in results], "o-", label="sessions completed")
    most = max(r.round_trips_mean for r in results) or 1.0
    trips = [r.round_trips_mean * r.completed_fraction / most for r in results]
    shares.plot(counts, trips, "^-", label="round trips, of those requested")
    shares.plot(counts, [r.busy_fraction for r in results], "s-", label="channel busy")
    shares.axhline(1.0, color="0.7", linewidth=0.8)
    shares.set_ylim(0.0, max(1.2, min(2.0, results[-1].airtime_fraction * 1.05)))
    shares.set_ylabel("fraction")
    shares.legend()
    shares.set_title(f"every station ranges to every other, every {period_s:g} s")
    delays_ms = [math.nan if r.mean_delay_ms is None else r.mean_delay_ms for r in results]
    delays.plot(counts, delays_ms, "o-")
    delays.set_ylim(bottom=0.0)
    delays.set_ylabel("mean delay of the completed, ms")
    delays.set_xlabel("stations")
    for axes in (shares, delays):
        axes.grid(visible=True, alpha=0.3)
    return figure

"""Figures of the radio's validation as PNG files, drawn with matplotlib's object interface."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from studies.common.figures import new_figure, save
from studies.radio.peers import Broadcasts, ErrorCurve, Saturated
from studies.radio.statistics import Mean, Mesh

LEAST_PER = 1e-4
RANGING_TICKS_M = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


def save_saturation(path: Path, rows: Sequence[tuple[str, Saturated, Mean]]) -> None:
    """Plot throughput over the number of stations: (``ns3`` or ``bianchi``, reference, ours)."""
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    for axes, reference, title in (
        (left, "ns3", "1000 B of UDP; crosses: ns-3 3.37"),
        (right, "bianchi", "1500 B; crosses: Bianchi's model"),
    ):
        curves: dict[tuple[int, bool], list[tuple[int, float, Mean]]] = {}
        for name, row, ours in rows:
            if name == reference:
                curve = curves.setdefault((row.rate_mbps, row.rts), [])
                curve.append((row.stations, row.throughput_mbps, ours))
        for i, ((rate_mbps, rts), curve) in enumerate(sorted(curves.items())):
            counts = [n for n, _, _ in curve]
            label = f"{rate_mbps} Mbit/s{', RTS' if rts else ''}"
            _errorbar(axes, counts, [ours for *_, ours in curve], color=f"C{i}", label=label)
            axes.plot(counts, [theirs for _, theirs, _ in curve], "x", color=f"C{i}", markersize=7)
        axes.set(xlabel="Saturated stations", title=title)
        axes.set_ylim(bottom=0.0)
        axes.legend(fontsize="small")
    left.set_ylabel("Throughput (Mbit/s)")
    save(figure, path, margin=0.03)


def save_broadcast(
    path: Path, rows: Sequence[tuple[Broadcasts, tuple[Mean, Mean], tuple[Mean, Mean]]], *, long_s: float
) -> None:
    """Plot delivery ratio and mean delay over the number of stations: (row, ours, ns-3's).

    Rows of the period ``long_s`` are on the left with a curve for each jitter, shorter periods on the right.
    """
    figure = new_figure(10.0, 7.6)
    grid = figure.subplots(2, 2)
    curves: dict[tuple[float, float], list[tuple[int, tuple[Mean, Mean], tuple[Mean, Mean]]]] = {}
    for row, ours, theirs in rows:
        curves.setdefault((row.period_s, row.jitter_s), []).append((row.stations, ours, theirs))
    for i, ((period_s, jitter_s), curve) in enumerate(curves.items()):
        column, label = (0, _jitter(jitter_s)) if period_s == long_s else (1, f"every {1e3 * period_s:g} ms")
        counts = [stations for stations, *_ in curve]
        for place in range(2):
            if place == 1 and jitter_s == 0.0:
                continue  # nothing is delivered, so there is no delay
            axes = grid[place][column]
            _errorbar(axes, counts, [ours[place] for _, ours, _ in curve], color=f"C{i}", label=label)
            _errorbar(
                axes, counts, [theirs[place] for *_, theirs in curve], color=f"C{i}", marker="x", linestyle=""
            )
    for column, title in enumerate((f"Every {1e3 * long_s:g} ms", "Phases drawn once, short periods")):
        ratios, delays = grid[0][column], grid[1][column]
        ratios.set(title=f"{title}; crosses: ns-3 3.37", ylim=(-0.03, 1.03))
        ratios.legend(fontsize="small", loc="best")
        delays.set(xlabel="Stations", yscale="log")
        delays.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        delays.yaxis.set_major_formatter("{x:g}")
        delays.yaxis.set_minor_formatter(NullFormatter())
    grid[0][0].set_ylabel("Delivered")
    grid[1][0].set_ylabel("Mean delay (ms)")
    save(figure, path, margin=0.03)


def _jitter(jitter_s: float) -> str:
    return "phases drawn once" if jitter_s < 0.0 else f"jitter {1e3 * jitter_s:g} ms"


def save_error_rates(
    path: Path, curves: Sequence[tuple[ErrorCurve, Sequence[float], Sequence[float]]]
) -> None:
    """Plot packet error rate over SNR: (ns-3's curve as dots, our ratios in dB and rates as lines)."""
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, model, title in (
        (left, "nist", "Non-HT, 20 MHz; dots: ns-3's NIST model"),
        (right, "table", "VHT, 80 MHz; dots: ns-3's tables"),
    ):
        chosen = [entry for entry in curves if entry[0].model == model]
        for i, (curve, snr_db, per) in enumerate(chosen):
            shown = [max(value, LEAST_PER / 10.0) for value in per]
            axes.semilogy(snr_db, shown, color=f"C{i}", linewidth=1.2, label=curve.mode)
            theirs = [max(value, LEAST_PER / 10.0) for value in curve.per]
            axes.semilogy(curve.snr_db, theirs, ".", color=f"C{i}", markersize=5)
        axes.axhline(0.1, color="black", linestyle=":", linewidth=0.9)
        lengths = {curve.frame_bytes for curve, *_ in chosen}
        axes.set(xlabel="SNR (dB)", title=f"{title}, {max(lengths, default=0)} B", ylim=(LEAST_PER, 1.3))
        axes.legend(fontsize="x-small", loc="lower right")
    left.set_ylabel("Packet error rate")
    save(figure, path, margin=0.03)


def save_ranging(
    path: Path, *, frames: Sequence[int], spreads: Mapping[int, tuple[float, list[float]]]
) -> None:
    """Plot the error's sigma over the round trips of a session, by width: (sigma of one trip, sigmas)."""
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    trips = np.array(frames) - 1
    for i, (width_mhz, (trip_m, sigmas_m)) in enumerate(spreads.items()):
        axes.loglog(trips, sigmas_m, "o", color=f"C{i}", label=f"{width_mhz} MHz")
        axes.loglog(
            trips, trip_m / np.sqrt(trips), "--", color=f"C{i}", linewidth=1.0, label=f"{trip_m:.3f} m / √n"
        )
    axes.set(
        xlabel="Round trips of a session, n", ylabel="Standard deviation of the distance (m)",
        title="Ranging error over 30 m",
    )  # fmt: skip
    axes.set_xticks(trips, [str(n) for n in trips])
    axes.minorticks_off()
    axes.set_yticks(RANGING_TICKS_M, [f"{tick_m:g}" for tick_m in RANGING_TICKS_M])
    axes.legend(fontsize="small")
    save(figure, path, margin=0.03)


def save_mesh(path: Path, periods: Mapping[float, Sequence[Mesh]]) -> None:
    """Plot shares and delay over the number of stations, by period."""
    figure = new_figure(10.0, 6.4)
    grid = figure.subplots(2, len(periods), sharex=True, sharey="row", squeeze=False)
    for column, (period_s, row) in enumerate(periods.items()):
        shares, delays = grid[0][column], grid[1][column]
        counts = [mesh.stations for mesh in row]
        shares.plot(counts, [mesh.requested for mesh in row], "k--", linewidth=1.0, label="requested")
        fits = [min(1.0 / mesh.requested, 1.0) for mesh in row]
        shares.plot(counts, fits, "k:", linewidth=1.0, label="fits")
        for label, marker, means in (
            ("sessions completed", "o", [mesh.completed for mesh in row]),
            ("round trips", "^", [mesh.round_trips for mesh in row]),
            ("channel busy", "s", [mesh.busy for mesh in row]),
        ):
            _errorbar(shares, counts, means, marker=marker, label=label)
        shares.set(title=f"Every pair every {period_s:g} s", ylim=(0.0, 1.5))
        shares.legend(fontsize="small")
        _errorbar(delays, counts, [mesh.delay_ms for mesh in row], marker="o")
        delays.set_xlabel("Stations")
    grid[0][0].set_ylabel("Share")
    grid[1][0].set_ylabel("Mean delay of the completed (ms)")
    grid[1][0].set_ylim(bottom=0.0)
    save(figure, path, margin=0.03)


def _errorbar(axes: Axes, counts: Sequence[int], means: Sequence[Mean], **style: Any) -> None:  # noqa: ANN401
    """Draw means with their standard errors."""
    errors = [mean.error or 0.0 for mean in means]
    axes.errorbar(counts, [mean.value for mean in means], errors, linewidth=1.2, **({"marker": "."} | style))

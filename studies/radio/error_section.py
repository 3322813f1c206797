"""Packet error rates compared with ns-3's models."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from netsim.phy.errors import packet_error_rate
from netsim.phy.modes import phy_mode
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_error_rates
from studies.radio.peers import ErrorCurve, ns3_error_curves
from studies.radio.plan import RadioPlan
from studies.radio.statistics import crossing_db

TARGET = 0.1
TOLERANCE_DB = {"nist": 0.3, "table": 0.5}
DRAWN_BYTES = 1458
DRAWN_POINTS = 701


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:  # noqa: ARG001  # common signature
    """Return one job for each of ns-3's curves: our rates at the same signal-to-noise ratios."""
    return {"curves": [partial(_rates, curve) for curve in ns3_error_curves()]}


def _rates(curve: ErrorCurve) -> tuple[float, ...]:
    mode = phy_mode(curve.mode, curve.width_mhz)
    return tuple(
        packet_error_rate(mode, curve.frame_bytes, 10.0 ** (snr_db / 10.0)) for snr_db in curve.snr_db
    )


def judge(plan: RadioPlan, results: Results) -> Section:  # noqa: ARG001  # common signature
    """Compare the signal-to-noise ratios at which the curves reach 10 %."""
    curves = ns3_error_curves()
    rates: list[tuple[float, ...]] = results["curves"]
    ours_db = [crossing_db(curve.snr_db, per, TARGET) for curve, per in zip(curves, rates, strict=True)]
    theirs_db = [crossing_db(curve.snr_db, curve.per, TARGET) for curve in curves]
    checks, cells = [], {}
    for curve, our_db, their_db in zip(curves, ours_db, theirs_db, strict=True):
        allowed_db = TOLERANCE_DB[curve.model]
        checks.append(
            Check(
                f"{curve.mode}, {curve.width_mhz} MHz, {curve.frame_bytes} B: SNR at PER {TARGET:g}", our_db,
                "dB", at_least=their_db - allowed_db, at_most=their_db + allowed_db,
            )
        )  # fmt: skip
        cells[curve.mode, curve.frame_bytes] = f"{our_db:.2f} ({their_db:.2f}; {our_db - their_db:+.2f})"
    lengths = sorted({curve.frame_bytes for curve in curves})
    return Section(
        title="Packet error rates",
        conditions=(
            "Frames of one length in white Gaussian noise, without their preamble: non-HT modes at 20 MHz "
            "compared with ns-3's NIST model, VHT modes with one spatial stream at 80 MHz compared with "
            "its tables, which come from link simulations. The signal-to-noise ratio (SNR) refers to the "
            "power in the channel. The compared value is the SNR at which the packet error rate is "
            f"{TARGET:g}; both are interpolated between the same points, 0.5 dB apart. It must agree within "
            f"{TOLERANCE_DB['nist']:g} dB with NIST and within {TOLERANCE_DB['table']:g} dB with the "
            "tables.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption=f"SNR at PER {TARGET:g}, dB (ns-3; difference):",
                columns=("mode", *(f"{length} B" for length in lengths)),
                rows=tuple(
                    (mode, *(cells.get((mode, length), "") for length in lengths))
                    for mode in dict.fromkeys(curve.mode for curve in curves)
                ),
            ),
        ),
        figures=(
            ReportFigure(
                "radio-per.png",
                "packet error rates of all modes, compared with ns-3",
                partial(_draw, curves=curves),
            ),
        ),
    )


def _draw(path: Path, curves: Sequence[ErrorCurve]) -> None:
    drawn = []
    for curve in curves:
        if curve.frame_bytes == DRAWN_BYTES:
            fine_db = tuple(np.linspace(curve.snr_db[0], curve.snr_db[-1], DRAWN_POINTS).tolist())
            drawn.append((curve, fine_db, _rates(replace(curve, snr_db=fine_db))))
    save_error_rates(path, drawn)

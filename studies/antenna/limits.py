"""Limits of the solvers: too few segments, wires that nearly touch, power balance errors."""

import math
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from msgspec import Struct

from antenna.lab.formations import ideal
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot, along, upright
from studies.antenna import near, power
from studies.antenna.agreement import AgreementCase, Compared, differences, formations
from studies.antenna.checks import difference, row, said_missing, solve, witness, worst
from studies.antenna.figures import save_convergence
from studies.antenna.ideal import EXACT_DBI, SOLVERS, places
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results

SEGMENTS = (5, 7, 9, 11, 15, 21, 31, 41, 61)
LONG_WAVELENGTHS_M = (5.0, 10.0, 20.0)
SHORT_SEGMENTS = (5, 9, 15, 21, 31)
REFINED = ((5.0, 9, 21), (5.0, 21, 41), (10.0, 9, 21), (20.0, 9, 21))
"""Wavelength and numbers of segments of random formations that NEC2 solves twice."""
UNCONVERGED_DB = 0.3
"""Least change of the patterns of 5 m dipoles at 5 m from 9 to 21 segments: the limit of batch."""
FOLLOWS_DB = 0.05
"""Limit of batch less NEC2 with the same segments."""
DIRECTIVITY_DB = 0.005
LEAST_APART_M, SEED = 0.35, 5
NEAR_M = (0.5, 0.2, 0.15, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Distances of two short dipoles side by side."""
BALANCED_M = 0.15
"""Distance from which the power of two dipoles fed in phase must balance."""
BALANCE = 0.01
TOUCHING = ("side by side, 0.3 mm", "one on the other", "crossing", "end to end", "through the ground")
"""Arrangements of two short dipoles that have no pattern."""


class LimitAnswer(Struct, frozen=True, kw_only=True):
    """Result of a solver for an array: gain, or the elements that touch."""

    max_gain_dbi: float = math.nan
    average_gain: float = math.nan
    refusal: str = ""
    touching: tuple[int, int] | None = None

    @property
    def directivity_dbi(self) -> float:
        """Gain over average gain; NaN if no power is radiated."""
        if not self.average_gain > 0.0:
            return math.nan
        return self.max_gain_dbi - 10.0 * math.log10(self.average_gain)


def long_config(wavelength_m: float, segments: int, solver: str) -> AntennaConfig:
    """Return the configuration of dipoles of 5 m length and 1 mm radius."""
    return _config(
        solver, wavelength_m=wavelength_m, element_length_m=5.0, element_radius_m=0.001, segments=segments
    )


def _config(solver: str, **fields: Any) -> AntennaConfig:  # noqa: ANN401
    return AntennaConfig(backend=solver, **fields)  # type: ignore[arg-type]


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:
    """Return the jobs: random formations, and arrays that do not depend on the plan."""
    return {
        "long": [
            partial(solve_ideal, long_config(wavelength_m, segments, solver))
            for wavelength_m in LONG_WAVELENGTHS_M for solver in ("nec2", "batch") for segments in SEGMENTS
        ],
        "refined": [partial(solve_refined, *setting, plan.other_formations) for setting in REFINED],
        "short": [partial(solve_ideal, _config("nec2", segments=segments)) for segments in SHORT_SEGMENTS],
        "near": [partial(solve_near, solver, apart_m) for apart_m in NEAR_M for solver in SOLVERS],
        "touching": [partial(solve_touching, solver, name) for name in TOUCHING for solver in SOLVERS],
        "power": power.jobs(plan),
        **near.jobs(plan),
    }  # fmt: skip


def solve_ideal(config: AntennaConfig) -> LimitAnswer | None:
    """Solve the ideal array."""
    return _answer(ideal(places(4, config.wavelength_m), config), config)


def solve_refined(wavelength_m: float, few: int, many: int, count: int) -> Compared | None:
    """Solve random formations of 5 m dipoles by NEC2 with few and with many segments."""
    configs = [long_config(wavelength_m, segments, "nec2") for segments in (few, many)]
    coarse, fine = (witness(config) for config in configs)
    if coarse is None or fine is None:
        return None
    case = AgreementCase(name="segments", config=configs[0], least_apart_m=LEAST_APART_M)
    snapshots, redrawn = formations(case, seed=SEED, count=count)
    found = fine.patterns(snapshots), coarse.patterns(snapshots)
    return differences(*found, (math.inf, math.inf), redrawn=redrawn)


def solve_near(solver: str, apart_m: float) -> LimitAnswer | None:
    """Solve two upright short dipoles fed in phase, at a distance along x."""
    centres_m = np.array([[0.0, 0.0, 0.0], [apart_m, 0.0, 0.0]])
    return _answer(upright(centres_m, np.ones(2, complex)), _config(solver))


def solve_touching(solver: str, name: str) -> LimitAnswer | None:
    """Solve two dipoles that touch, or of which one is in the ground."""
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    second_m, height_m, fields = (0.0003, 0.0, 0.0), 0.0, {}
    if name == "one on the other":
        second_m = (0.0, 0.0, 0.0)
    elif name == "crossing":
        second_m, axes[1] = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    elif name == "end to end":
        second_m = (0.0, 0.0, 0.05)
    elif name == "through the ground":
        second_m, height_m, fields = (5.0, 0.0, 0.0), 0.02, {"ground": "perfect"}
    centres_m = np.array([(0.0, 0.0, height_m), second_m + np.array([0.0, 0.0, height_m])])
    return _answer(Snapshot(centres_m, along(axes), np.ones(2, complex)), _config(solver, **fields))


def _answer(snapshot: Snapshot, config: AntennaConfig) -> LimitAnswer | None:
    found = solve(snapshot, config)
    if isinstance(found, ElementsTouch):
        return LimitAnswer(refusal=str(found), touching=(found.first, found.second))
    if found is None:
        return None
    return LimitAnswer(max_gain_dbi=found.max_gain_dbi, average_gain=found.average_gain)


def judge(plan: AntennaPlan, results: Results) -> Section:  # noqa: ARG001  # common signature
    """Check the known limits, and list the other results."""
    long = dict(zip(product(LONG_WAVELENGTHS_M, ("nec2", "batch"), SEGMENTS), results["long"], strict=True))
    short = dict(zip(SHORT_SEGMENTS, results["short"], strict=True))
    two = dict(zip(product(NEAR_M, SOLVERS), results["near"], strict=True))
    touching = dict(zip(product(TOUCHING, SOLVERS), results["touching"], strict=True))
    checks, table = _of_segments(long)
    further, refined = _of_refinement(results["refined"])
    more, balance = _of_balance(short)
    close, distances = _of_near(two)
    last, refusals = _of_touching(touching)
    faint, powers = power.judge(results["power"])
    meeting, crowds = near.judge(results)
    curves: dict[str, list[tuple[int, float]]] = {}
    for (wavelength_m, solver, segments), found in long.items():
        if found is not None:
            curve = curves.setdefault(f"{solver}, {wavelength_m:g} m", [])
            curve.append((segments, found.max_gain_dbi))
    figure = ReportFigure(
        "antenna-convergence.png", "maximum gain of 5 m dipoles over their segments",
        partial(save_convergence, curves=curves),
    )  # fmt: skip
    return Section(
        title="Known limits",
        conditions=(
            "The ideal array of 5 m dipoles (1 mm radius) and of short dipoles with an increasing number "
            "of segments; short dipoles of decreasing size relative to the wavelength; two short dipoles, "
            "fed in phase, at decreasing distance, by themselves and in an array; loops too wide for their "
            "places; and arrangements without a pattern, which every solver must reject with the same two "
            "elements. A lossless array radiates its input power, so its average gain is 1 up to the "
            "solver's error.\n" + said_missing(s for s in SOLVERS if two[NEAR_M[0], s] is None)
        ),
        checks=(*checks, *further, *more, *faint, *close, *meeting, *last),
        tables=(table, refined, balance, powers, distances, *crowds, refusals),
        figures=(figure,),
    )


def _of_segments(long: dict[tuple[float, str, int], LimitAnswer | None]) -> tuple[list[Check], ReportTable]:
    checks: list[Check] = []
    rows = []
    for wavelength_m in LONG_WAVELENGTHS_M:
        apart = []
        for segments in SEGMENTS:
            nec2, batch = long[wavelength_m, "nec2", segments], long[wavelength_m, "batch", segments]
            if nec2 is None or batch is None:
                continue
            apart.append(batch.max_gain_dbi - nec2.max_gain_dbi)
            rows.append(row(f"{wavelength_m:g}", segments, nec2.max_gain_dbi, batch.max_gain_dbi, apart[-1],
                            nec2.average_gain))  # fmt: skip
        if apart:
            name = f"batch less nec2 of the same segments, 5 m at {wavelength_m:g} m, at worst"
            checks.append(difference(name, worst(apart), FOLLOWS_DB, "dB"))
    return checks, ReportTable(
        caption="Ideal array of dipoles of 5 m, maximum in dBi:",
        columns=("wavelength m", "segments", "nec2", "batch", "less nec2 dB", "average gain of nec2"),
        rows=tuple(rows),
    )


def _of_refinement(results: list[Compared | None]) -> tuple[list[Check], ReportTable]:
    checks, rows = [], []
    for (wavelength_m, few, many), found in zip(REFINED, results, strict=True):
        if found is None:
            continue
        maximum_db, pattern_db = np.abs(found.maximum_db), np.abs(found.pattern_db)
        rows.append((
            f"{wavelength_m:g}", f"{few} to {many}", str(len(maximum_db)), f"{maximum_db.max():.3f}",
            f"{np.median(pattern_db):.3f}", f"{pattern_db.max():.3f}",
        ))  # fmt: skip
        if (wavelength_m, few, many) == REFINED[0]:
            name = f"nec2, 5 m at 5 m, {few} to {many} segments: pattern, median; it has not converged"
            checks.append(Check(name, float(np.median(pattern_db)), "dB", at_least=UNCONVERGED_DB))
    return checks, ReportTable(
        caption="Random formations of dipoles of 5 m (0.5 m, 10 degrees), NEC2 with more segments less NEC2 "
        "with fewer. One reference states 0.94 dB from 9 to 21 segments at 5 m, but not of which quantity; "
        "the pattern changes by that much, the maximum does not:",
        columns=("wavelength m", "segments", "formations", "maximum: greatest dB", "pattern: median dB",
                 "greatest dB"),
        rows=tuple(rows),
    )  # fmt: skip


def _of_balance(short: dict[int, LimitAnswer | None]) -> tuple[list[Check], ReportTable]:
    found = {segments: one for segments, one in short.items() if one is not None}
    checks = [
        difference(
            f"nec2, short dipoles: directivity, less {EXACT_DBI:g}, at worst of {len(found)} numbers of "
            "segments",
            worst(one.directivity_dbi - EXACT_DBI for one in found.values()), DIRECTIVITY_DB, "dB",
        )
    ] if found else []  # fmt: skip
    return checks, ReportTable(
        caption="Short dipoles at 10 m by NEC2: the number of segments affects the average gain only:",
        columns=("segments", "maximum dBi", "average gain", "directivity dBi"),
        rows=tuple(
            (str(n), f"{one.max_gain_dbi:.4f}", f"{one.average_gain:.5f}", f"{one.directivity_dbi:.4f}")
            for n, one in found.items()
        ),
    )


def _of_near(two: dict[tuple[float, str], LimitAnswer | None]) -> tuple[list[Check], ReportTable]:
    checks, rows = [], []
    for solver in SOLVERS:
        balances = [
            one.average_gain - 1.0 for m in NEAR_M if m >= BALANCED_M and (one := two[m, solver]) is not None
        ]
        if balances:
            name = f"{solver}, short dipoles {BALANCED_M:g} m apart or more: average gain, less 1, at worst"
            checks.append(difference(name, worst(balances), BALANCE, ""))
    for apart_m in NEAR_M:
        found = [two[apart_m, solver] for solver in SOLVERS]
        cells = [
            cell
            for one in found
            for cell in ((None, None) if one is None else (one.refusal or one.max_gain_dbi, one.average_gain))
        ]
        rows.append(row(f"{1e3 * apart_m:g}", *cells))
    columns = ("apart mm", *(f"{solver}{what}" for solver in SOLVERS for what in (" dBi", ": average gain")))
    return checks, ReportTable(
        caption="Two short dipoles of 50 mm side by side, in phase, 10 m:", columns=columns, rows=tuple(rows)
    )


def _of_touching(touching: dict[tuple[str, str], LimitAnswer | None]) -> tuple[list[Check], ReportTable]:
    checks, rows = [], []
    for name in TOUCHING:
        found = {solver: one for solver in SOLVERS if (one := touching[name, solver]) is not None}
        refused = [one.touching for one in found.values()]
        checks.append(
            Check(
                f"solvers, of {len(refused)}, that refuse two dipoles by the same elements: {name}",
                float(sum(pair is not None and pair == refused[0] for pair in refused)),
                at_least=float(len(refused)),
            )
        )  # fmt: skip
        rows.append(
            (name, "; ".join(f"{solver}: {one.refusal or 'a pattern'}" for solver, one in found.items()))
        )
    return checks, ReportTable(
        caption="Errors of the rejected arrangements:",
        columns=("two short dipoles", "error"),
        rows=tuple(rows),
    )

"""Elements that nearly touch: two of eight short dipoles, and loops too wide for their places."""

from functools import partial

import numpy as np
from msgspec import Struct

from antenna.model.clearance import CREDIBLE
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Snapshot
from antenna.solvers.interface import Accuracy
from studies.antenna import agreement
from studies.antenna.checks import difference, witness, worst
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportTable
from studies.common.runner import Job, Results

APART_M = (0.5, 0.3, 0.2, 0.15, 0.1, 0.08, 0.05, 0.03)
"""Distances of two short dipoles' centres, at 10 m."""
FULLY_M = 0.05
"""One dipole length; from it on the batch solver's full accuracy is required, below it only directivity."""
OTHERS = ("batch", "nec2c")
MOVED, BESIDE = 1, 4
STEEPEST = 0.3
"""Largest height difference of the two as a fraction of their horizontal distance."""
SEED = 3
ROUND_M = (5.0, 10.0, 12.0)
"""Circumferences of loops with twelve sides, at 10 m."""
WIDE_LOOP_DB = agreement.LIMITS_DB[Accuracy.LARGE_ELEMENTS][0]


class Pairs(Struct, frozen=True, kw_only=True):
    """Formations with two elements near each other, solved by all solvers."""

    others: dict[str, agreement.Compared]
    """Installed solvers less PyNEC; rejected formations count as touching"""


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:
    """Return one job for each distance and each loop."""
    return {
        "pairs": [partial(solve_pairs, apart_m, plan.other_formations) for apart_m in APART_M],
        "loops": [
            partial(agreement.compare, _loops(m), "batch", count=plan.other_formations) for m in ROUND_M
        ],
    }


def _loops(round_m: float) -> agreement.AgreementCase:
    return agreement.AgreementCase(
        name=f"loops of {round_m:g} m", config=AntennaConfig(**agreement.LOOP | {"element_length_m": round_m})
    )


def pairs(apart_m: float, count: int) -> list[Snapshot]:
    """Return random formations of short dipoles (0.5 m, 10 degrees) with one element moved near another."""
    snapshots, _ = agreement.formations(
        agreement.AgreementCase(name="pairs", config=AntennaConfig()), seed=SEED, count=count
    )
    rng = np.random.default_rng(SEED)
    found = []
    for snapshot in snapshots:
        centres_m, angle_rad = snapshot.centres_m.copy(), rng.uniform(0.0, 2.0 * np.pi)
        away = np.array([np.cos(angle_rad), np.sin(angle_rad), rng.uniform(-STEEPEST, STEEPEST)])
        centres_m[MOVED] = centres_m[BESIDE] + apart_m * away / np.linalg.norm(away)
        found.append(Snapshot(centres_m, snapshot.rotations, snapshot.voltages))
    return found


def solve_pairs(apart_m: float, count: int) -> Pairs | None:
    """Solve formations of `pairs`; None without PyNEC."""
    nec2 = witness(AntennaConfig(backend="nec2"))
    if nec2 is None:
        return None
    snapshots = pairs(apart_m, count)
    expected, others = nec2.patterns(snapshots), {}
    for name in OTHERS:
        solver = witness(AntennaConfig(backend=name))  # type: ignore[arg-type]
        if solver is not None:
            limits_db = agreement.LIMITS_DB[Accuracy.SMALL_ELEMENTS]
            others[name] = agreement.differences(solver.patterns(snapshots), expected, limits_db, redrawn=0)
    return Pairs(others=others)


def judge(results: Results) -> tuple[list[Check], list[ReportTable]]:
    """Check the solved formations, and that all solvers reject the same ones."""
    found = {m: one for m, one in zip(APART_M, results["pairs"], strict=True) if one is not None}
    checks: list[Check] = []
    rows = []
    for name in OTHERS:
        of = {m: one.others[name] for m, one in found.items() if name in one.others}
        if of:
            checks += _of_pairs(name, of)
        for apart_m, one in found.items():
            if name in one.others:
                rows.append(agreement.cells(f"{name}, {1e3 * apart_m:g} mm", one.others[name]))
    least, most = CREDIBLE
    tables = [
        ReportTable(
            caption="Eight short dipoles at 10 m in random formations (0.5 m, 10 degrees), with the second "
            "dipole moved near the fifth; less PyNEC. Their near fields exchange far more power than they "
            "radiate, and the thin-wire equations lose their power balance: every solver rejects a "
            f"solution that radiates less than {least:g} or more than {most:g} of the input power; it is "
            "counted under touch. For all other formations the solvers agree, except for the last digits "
            f"of the power if the dipoles are nearer than their length of {1e3 * FULLY_M:g} mm:",
            columns=agreement.COLUMNS, rows=tuple(rows),
        )
    ] if rows else []  # fmt: skip
    loops = [(m, one) for m, one in zip(ROUND_M, results["loops"], strict=True) if one is not None]
    for round_m, one in loops:
        title = f"batch less nec2, loops of {round_m:g} m at 10 m: maximum, at worst"
        checks.append(difference(title, worst(one.maximum_db), WIDE_LOOP_DB, "dB"))
    if loops:
        caption = (
            "Loops of 12 sides at 10 m in rows 2.5 m apart, less PyNEC. Loops with a circumference of one "
            "wavelength overlap and have more current modes than the batch solver represents; it claims no "
            "accuracy for loops of more than a tenth of a wavelength. The limit of the maximum is still that "
            "of large elements:"
        )
        named = tuple(agreement.cells(_loops(round_m).name, one) for round_m, one in loops)
        tables.append(ReportTable(caption=caption, columns=agreement.COLUMNS, rows=named))
    return checks, tables


def _of_pairs(name: str, of: dict[float, agreement.Compared]) -> list[Check]:
    whole, title = agreement.together(list(of.values())), f"{name} less nec2, two dipoles of 0.05 m"
    maximum_db = [value for apart_m, one in of.items() if apart_m >= FULLY_M for value in one.maximum_db]
    near = f"{1e3 * APART_M[-1]:g} to {1e3 * APART_M[0]:g} mm apart"
    far = f"{1e3 * FULLY_M:g} to {1e3 * APART_M[0]:g} mm apart"
    return [
        difference(f"{title} {far}: maximum, at worst", worst(maximum_db), whole.limits_db[0], "dB"),
        difference(
            f"{title} {near}: directivity, at worst", worst(whole.directivity_db), whole.limits_db[0], "dB"
        ),
        difference(f"{title} {near}: pattern, at worst", worst(whole.pattern_db), whole.limits_db[1], "dB"),
        Check(f"{title} {near}: refused by one alone", whole.disagreeing, at_most=0.0),
    ]

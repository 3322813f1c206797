"""Comparison of the batch solver with NEC2 on random formations, and of nec2c with PyNEC."""

import math
from functools import partial
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from antenna.analysis.patterns import Pattern
from antenna.lab.formations import Disorder, draws
from antenna.model.clearance import least_distance_m, placed_wires_m
from antenna.model.config import AntennaConfig
from antenna.model.elements import Element
from antenna.model.geometry import Array, ElementsTouch, Snapshot, grid
from antenna.solvers.interface import Accuracy
from studies.antenna.checks import difference, said_missing, witness, worst
from studies.antenna.figures import save_agreement
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results

SEEN_DBI = -20.0
"""Patterns are compared where NEC2's gain is higher than this."""
LIMITS_DB = {
    Accuracy.SMALL_ELEMENTS: (0.01, 0.1),
    Accuracy.FAINT_ELEMENTS: (0.01, 0.1),
    Accuracy.LARGE_ELEMENTS: (0.05, 0.3),
}
"""Limits of the maximum or directivity, and of the pattern, by the accuracy class of the batch solver."""
UNCLAIMED_DB = (math.inf, math.inf)
"""Limits of classes without an accuracy claim."""
WITNESS_LIMITS_DB = (0.005, 0.05)
"""Limits of nec2c less PyNEC: the same equations, but nec2c prints five digits."""
COLUMNS = (
    "formations", "compared", "drawn again", "touch", "maximum: rms dB", "greatest dB",
    "directivity: greatest dB", "pattern: median dB", "greatest dB", "average gain", "of NEC2",
)  # fmt: skip
"""Columns of a table with rows from `cells`."""
AT_A_TIME = 20
"""Formations in a job."""
SHORT: dict[str, Any] = {}
LONG: dict[str, Any] = {"element_length_m": 5.0, "element_radius_m": 0.001, "segments": 11}
LOOP: dict[str, Any] = {
    "element_kind": "loop", "element_length_m": 1.0, "element_radius_m": 0.001, "segments": 12
}  # fmt: skip
BRANCHED = """CE a dipole with two arms at its top
GW 1 9 0 0 -0.5 0 0 0.5 0.001
GW 2 3 0 0 0.5 0.3 0 0.6 0.001
GW 3 3 0 0 0.5 -0.3 0 0.6 0.001
GE 0
EX 0 1 5 0 1 0
EN
"""
DECK: dict[str, Any] = {"element_kind": "deck", "element_deck": BRANCHED}
OVER_GROUND: dict[str, Any] = {"ground": "perfect"}


class AgreementCase(Struct, frozen=True, kw_only=True):
    """One kind of random formation."""

    name: str
    config: AntennaConfig
    required: bool = False
    """Whether it is checked with the full number of formations"""
    columns: int = 4
    rows: int = 2
    height_m: float = 0.0
    sigma_m: float = 0.5
    tilt_deg: float = 10.0
    least_apart_m: float = 0.0
    """A formation with wires of two elements nearer than this is drawn again."""
    by_directivity: bool = False
    """Check directivity instead of the maximum, because NEC2's two programs disagree about the power."""


class Compared(Struct, frozen=True, kw_only=True):
    """Results of one or more lots, one number for each formation that both solvers solved."""

    limits_db: tuple[float, float]
    maximum_db: tuple[float, ...]
    """Maximum gain less NEC2's."""
    pattern_db: tuple[float, ...]
    """Total gain less NEC2's in the direction of the greatest difference, where NEC2 has `SEEN_DBI`."""
    directivity_db: tuple[float, ...]
    """Maximum gain over average gain, less NEC2's: free of the power balance errors of both solvers."""
    average_gain: tuple[float, ...]
    nec2_average_gain: tuple[float, ...]
    redrawn: int
    """Formations rejected because of too small wire distances."""
    touching: int
    """Formations that both solvers report as touching."""
    disagreeing: int
    """Formations that only one solver reports as touching."""


def _case(name: str, shape: dict[str, Any], wavelength_m: float, **fields: Any) -> AgreementCase:  # noqa: ANN401
    return AgreementCase(name=name, config=AntennaConfig(wavelength_m=wavelength_m, **shape), **fields)


CASES = (
    _case("short dipoles, 10 m", SHORT, 10.0, required=True),
    *(
        _case(f"dipoles of 5 m, {w:g} m", LONG, w, required=True, least_apart_m=0.35)
        for w in (10.0, 15.0, 20.0)
    ),
    _case("short dipoles, 5 m", SHORT, 5.0),
    _case("short dipoles, 20 m, σ 2 m", SHORT, 20.0, sigma_m=2.0, least_apart_m=0.15, by_directivity=True),
    _case("short dipoles, 10 m, σ 0.1 m, tilt 2°", SHORT, 10.0, sigma_m=0.1, tilt_deg=2.0),
    _case("short dipoles, 10 m, σ 1 m, tilt 45°", SHORT, 10.0, sigma_m=1.0, tilt_deg=45.0,
          least_apart_m=0.15),
    _case("short dipoles, 10 m, 2x4", SHORT, 10.0, columns=2, rows=4),
    _case("short dipoles, 10 m, 4x3", SHORT, 10.0, columns=4, rows=3),
    _case("short dipoles, 10 m, Hansen-Woodyard", {"excitation": "hansen_woodyard"}, 10.0),
    _case("short dipoles, 10 m, optimum", {"excitation": "optimum", "feeds_for": "truth"}, 10.0),
    _case("short dipoles, 10 m, over perfect ground", OVER_GROUND, 10.0, height_m=10.0),
    _case("dipoles of 2 m, 10 m", {**LONG, "element_length_m": 2.0}, 10.0, least_apart_m=0.35),
    _case("dipoles of 5 m, 20 m, σ 1 m, tilt 30°", LONG, 20.0, sigma_m=1.0, tilt_deg=30.0,
          least_apart_m=0.35),
    _case("dipoles of 5 m, 10 m, over perfect ground", LONG | OVER_GROUND, 10.0, height_m=10.0,
          least_apart_m=0.35),
    _case("dipoles of 5 m, 20 m, over perfect ground", LONG | OVER_GROUND, 20.0, height_m=10.0,
          least_apart_m=0.35),
    _case("loops of 1 m, 10 m", LOOP, 10.0, least_apart_m=0.35),
    _case("loops of 1 m, 10 m, over perfect ground", LOOP | OVER_GROUND, 10.0, height_m=10.0,
          least_apart_m=0.35),
    _case("branched wires, 10 m", DECK, 10.0, least_apart_m=0.35),
)  # fmt: skip
WITNESSED = (
    CASES[0],
    CASES[1],
    _case("short dipoles, 10 m, over perfect ground", OVER_GROUND, 10.0, height_m=10.0),
    _case("dipoles of 5 m, 10 m, over real ground", LONG | {"ground": "real", "backend": "nec2"}, 10.0,
          height_m=10.0, least_apart_m=0.35),
    _case("loops of 1 m, 10 m", LOOP, 10.0, least_apart_m=0.35),
)  # fmt: skip
"""Cases for nec2c, including real ground, which the batch solver does not support."""


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:
    """Return the lots of all cases."""
    return {
        "batch": [
            partial(compare, case, "batch", number=first, count=min(AT_A_TIME, count - first))
            for case in CASES
            for count in [plan.formations if case.required else plan.other_formations]
            for first in range(0, count, AT_A_TIME)
        ],
        "nec2c": [partial(compare, case, "nec2c", count=plan.witness_formations) for case in WITNESSED],
    }


def compare(case: AgreementCase, solver: str, *, number: int = 0, count: int) -> Compared | None:
    """Draw formations and solve them with ``solver`` and PyNEC; None if one is not installed."""
    ours, nec2 = (witness(replace(case.config, backend=name)) for name in (solver, "nec2"))
    if ours is None or nec2 is None:
        return None
    snapshots, redrawn = formations(case, seed=1 + number, count=count)
    limits_db = WITNESS_LIMITS_DB if solver == "nec2c" else LIMITS_DB.get(ours.accuracy, UNCLAIMED_DB)
    return differences(ours.patterns(snapshots), nec2.patterns(snapshots), limits_db, redrawn=redrawn)


def formations(case: AgreementCase, *, seed: int, count: int) -> tuple[list[Snapshot], int]:
    """Return random formations with the required wire distance, and the number of rejected ones."""
    element, wavelength_m = case.config.element(), case.config.wavelength_m
    places_m = grid(case.columns * case.rows, case.columns, 0.85 * wavelength_m, 0.25 * wavelength_m)
    places_m[:, 2] = case.height_m
    disorder = Disorder(sigma_m=case.sigma_m, tilt_rad=float(np.radians(case.tilt_deg)), seed=seed)
    found: list[Snapshot] = []
    redrawn = 0
    for snapshot in draws(places_m, case.config, disorder):
        if case.least_apart_m > 0.0 and least_apart_m(snapshot, element) < case.least_apart_m:
            redrawn += 1
            continue
        found.append(snapshot)
        if len(found) == count:
            break
    return found, redrawn


def least_apart_m(snapshot: Snapshot, element: Element) -> float:
    """Return the least distance between the wires of two elements."""
    wires_m = placed_wires_m(snapshot, element)
    return min(least_distance_m(wires_m[i], wires_m[j]) for i in range(len(wires_m)) for j in range(i))


def differences(
    ours: list[Pattern | ElementsTouch],
    nec2: list[Pattern | ElementsTouch],
    limits_db: tuple[float, float],
    *,
    redrawn: int,
) -> Compared:
    """Return the differences of the results, formation by formation."""
    maximum_db, pattern_db, directivity_db = [], [], []
    averages, nec2_averages = [], []
    touching = disagreeing = 0
    for one, other in zip(ours, nec2, strict=True):
        if isinstance(one, ElementsTouch) or isinstance(other, ElementsTouch):
            both = isinstance(one, ElementsTouch) and isinstance(other, ElementsTouch)
            touching, disagreeing = touching + both, disagreeing + (not both)
            continue
        maximum_db.append(one.max_gain_dbi - other.max_gain_dbi)
        pattern_db.append(greatest_difference_db(one.gain_dbi, other.gain_dbi))
        balance_db = 10.0 * math.log10(one.average_gain / other.average_gain)
        directivity_db.append(maximum_db[-1] - balance_db)
        averages.append(one.average_gain)
        nec2_averages.append(other.average_gain)
    return Compared(
        limits_db=limits_db, maximum_db=tuple(maximum_db), pattern_db=tuple(pattern_db),
        directivity_db=tuple(directivity_db), average_gain=tuple(averages),
        nec2_average_gain=tuple(nec2_averages),
        redrawn=redrawn, touching=touching, disagreeing=disagreeing,
    )  # fmt: skip


def greatest_difference_db(gain_dbi: Array, nec2_dbi: Array) -> float:
    """Return the greatest difference of two patterns on one grid, where NEC2's gain exceeds `SEEN_DBI`."""
    return worst((gain_dbi - nec2_dbi)[nec2_dbi > SEEN_DBI].tolist())


def together(lots: list[Compared]) -> Compared:
    """Return the combined results of all lots of a case, at least one."""
    return Compared(
        limits_db=lots[0].limits_db,
        maximum_db=tuple(value for lot in lots for value in lot.maximum_db),
        pattern_db=tuple(value for lot in lots for value in lot.pattern_db),
        directivity_db=tuple(value for lot in lots for value in lot.directivity_db),
        average_gain=tuple(value for lot in lots for value in lot.average_gain),
        nec2_average_gain=tuple(value for lot in lots for value in lot.nec2_average_gain),
        redrawn=sum(lot.redrawn for lot in lots),
        touching=sum(lot.touching for lot in lots),
        disagreeing=sum(lot.disagreeing for lot in lots),
    )


def judge(plan: AntennaPlan, results: Results) -> Section:
    """Check the greatest difference of every case."""
    checks: list[Check] = []
    rows: dict[str, list[tuple[str, ...]]] = {"batch": [], "nec2c": []}
    drawn: list[tuple[str, Compared]] = []
    absent: set[str] = set()
    for solver, cases in (("batch", CASES), ("nec2c", WITNESSED)):
        lots: dict[str, list[Compared]] = {}
        for job, found in zip(jobs(plan)[solver], results[solver], strict=True):
            if found is None:
                absent.add("nec2 (PyNEC), which all comparisons require" if solver == "batch" else "nec2c")
            else:
                lots.setdefault(job.args[0].name, []).append(found)
        for case in cases:
            if case.name in lots:
                whole = together(lots[case.name])
                checks += requirements(f"{solver}, {case.name}", whole, by_directivity=case.by_directivity)
                rows[solver].append(cells(case.name, whole))
                if case.required and solver == "batch":
                    drawn.append((case.name, whole))
    shown = [(name, (of.maximum_db, of.pattern_db), of.limits_db) for name, of in drawn]
    figure = ReportFigure(
        "antenna-agreement.png", "distribution of the formations' differences from NEC2",
        partial(save_agreement, cases=shown),
    )  # fmt: skip
    return Section(
        title="Batch against NEC2",
        conditions=(
            "Both solvers compute the same random formations: eight elements, 4x2 unless stated otherwise, "
            "each displaced by a Gaussian error of 0.5 m on every axis and turned by a Gaussian error of "
            "10 degrees about x and about y, in free space or 10 m over perfect ground, and fed with the "
            "ideal phases. Compared are the refined maximum, and the total gain on a grid of 5 degrees in "
            f"the direction of the greatest difference, where NEC2's gain is above {SEEN_DBI:g} dBi. Long "
            "dipoles have 11 segments and 1 mm radius; formations with wires nearer to each other than "
            "0.35 m (short dipoles with errors of 1 m and more: 0.15 m) are drawn again and counted. The "
            "limits follow from the accuracy class of the batch solver for the element. Directivity is the "
            "maximum over the average gain: where it agrees better than the maximum, one of the solvers "
            "has a power balance error, and the average gains show which one. Dipoles of 0.05 m at 20 m "
            "are compared by directivity, because PyNEC and nec2c disagree about their input power, by "
            "0.007 dB for the ideal array (see above) and by more under known limits, where the reason is "
            "given.\n"
            + said_missing(absent)
        ),
        checks=tuple(checks),
        tables=tuple(
            ReportTable(caption=caption, columns=COLUMNS, rows=tuple(rows[solver]))
            for solver, caption in (
                ("batch", "The batch solver less PyNEC:"), ("nec2c", "The program nec2c less PyNEC:"),
            )
            if rows[solver]
        ),
        figures=(figure,) if drawn else (),
    )  # fmt: skip


def requirements(name: str, of: Compared, *, by_directivity: bool = False) -> list[Check]:
    """Return the checks of one case."""
    judged, values_db = ("directivity", of.directivity_db) if by_directivity else ("maximum", of.maximum_db)
    return [
        difference(f"{name}: {judged}", worst(values_db), of.limits_db[0], "dB"),
        difference(f"{name}: pattern", worst(of.pattern_db), of.limits_db[1], "dB"),
        *([Check(f"{name}: touch for one alone", of.disagreeing, at_most=0.0)] if of.disagreeing else []),
    ]


def cells(name: str, of: Compared) -> tuple[str, ...]:
    """Return one row of a table; most cells are empty if no formation was solved by both."""
    averages = (f"{min(values):.4f} to {max(values):.4f}" if values else "" for values in
                (of.average_gain, of.nec2_average_gain))  # fmt: skip
    if not of.maximum_db:
        return name, "0", str(of.redrawn), str(of.touching), "", "", "", "", "", *averages
    maximum_db, pattern_db = np.abs(of.maximum_db), np.abs(of.pattern_db)
    return (
        name, str(len(maximum_db)), str(of.redrawn), str(of.touching),
        f"{np.sqrt((maximum_db**2).mean()):.5f}", f"{maximum_db.max():.5f}",
        f"{np.abs(of.directivity_db).max():.5f}",
        f"{np.median(pattern_db):.4f}", f"{pattern_db.max():.4f}", *averages,
    )  # fmt: skip

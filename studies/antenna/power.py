"""Input power of very small dipoles, which NEC2's arithmetic does not resolve."""

import math
from functools import partial
from itertools import product

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from antenna.model.config import AntennaConfig
from antenna.model.geometry import upright
from antenna.solvers.interface import Accuracy
from antenna.solvers.ports import ports
from antenna.solvers.selection import make_backend
from studies.antenna.agreement import LIMITS_DB, AgreementCase, Compared, differences, formations
from studies.antenna.checks import difference, witness, worst
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportTable
from studies.common.runner import Job

PROGRAMS = ("nec2", "nec2c")
SIZES = ((10.0, 9), (20.0, 3), (20.0, 9), (20.0, 21), (40.0, 3), (40.0, 9))
"""(Wavelength, number of segments) of a dipole of 0.05 m."""
USUAL_SEGMENTS = 9
FAINTEST = (40.0, 9)
DIRECTIVITY_DB = 0.005
STEADY = 0.001
"""Largest range of the batch solver's average gain over formations and wavelengths."""
SEED = 1


class Balance(Struct, frozen=True, kw_only=True):
    """Random formations solved by all solvers."""

    resistance_of_reactance: float
    """Ratio for the input impedance of one dipole, by the batch solver"""
    programs: dict[str, Compared]
    """Installed NEC2 programs less the batch solver"""
    batch: Compared
    """The batch solver less itself; contains its average gains"""


def jobs(plan: AntennaPlan) -> list[Job]:
    """Return one job for each wavelength and number of segments."""
    return [partial(solve, *size, plan.other_formations) for size in SIZES]


def solve(wavelength_m: float, segments: int, count: int) -> Balance:
    """Solve formations of short dipoles (0.5 m, 10 degrees) with all installed solvers."""
    config = AntennaConfig(wavelength_m=wavelength_m, segments=segments)
    snapshots, redrawn = formations(AgreementCase(name="power", config=config), seed=SEED, count=count)
    alone = ports(upright(np.zeros((1, 3)), np.ones(1, complex)), config)
    impedance_ohm = 1.0 / complex(alone.admittance_s[0, 0])
    programs = {name: witness(replace(config, backend=name)) for name in PROGRAMS}
    ours, limits_db = make_backend(config).patterns(snapshots), (math.inf, math.inf)
    return Balance(
        resistance_of_reactance=impedance_ohm.real / abs(impedance_ohm.imag),
        programs={
            name: differences(solver.patterns(snapshots), ours, limits_db, redrawn=redrawn)
            for name, solver in programs.items()
            if solver is not None
        },
        batch=differences(ours, ours, limits_db, redrawn=redrawn),
    )


def judge(results: list[Balance | None]) -> tuple[list[Check], ReportTable]:
    """Check directivity everywhere, and that the maximum of the smallest dipoles exceeds its limit."""
    found = {size: one for size, one in zip(SIZES, results, strict=True) if one is not None}
    checks = []
    for name in PROGRAMS:
        of = {size: one.programs[name] for size, one in found.items() if name in one.programs}
        if of:
            title = f"{name} less batch, dipoles of 0.05 m at 10 to 40 m: directivity, at worst"
            apart_db = worst(value for one in of.values() for value in one.directivity_db)
            checks.append(difference(title, apart_db, DIRECTIVITY_DB, "dB"))
        if FAINTEST in of:
            maximum_db = abs(worst(of[FAINTEST].maximum_db))
            title = f"{name} less batch, 0.05 m at {FAINTEST[0]:g} m: maximum, greatest; power is not certain"
            least_db = LIMITS_DB[Accuracy.SMALL_ELEMENTS][0]
            checks.append(Check(title, maximum_db, "dB", at_least=least_db))
    usual = [one.batch.average_gain for (_, n), one in found.items() if n == USUAL_SEGMENTS]
    if usual:
        gains = [value for one in usual for value in one]
        title = f"batch, {USUAL_SEGMENTS} segments, 10 to 40 m: average gain, greatest less least"
        checks.append(Check(title, max(gains) - min(gains), at_most=STEADY))
    return checks, _table(found)


def _table(found: dict[tuple[float, int], Balance]) -> ReportTable:
    rows = []
    for ((wavelength_m, segments), one), solver in product(found.items(), (*PROGRAMS, "batch")):
        of = one.batch if solver == "batch" else one.programs.get(solver)
        if of is None or not of.average_gain:
            continue
        gains = np.array(of.average_gain)
        apart = ("", "") if solver == "batch" else (
            f"{np.abs(of.maximum_db).max():.4f}", f"{np.abs(of.directivity_db).max():.5f}"
        )  # fmt: skip
        rows.append((
            f"{wavelength_m:g}", str(segments), f"{one.resistance_of_reactance:.2g}", solver, str(len(gains)),
            f"{gains.min():.4f} to {gains.max():.4f}", f"{gains.std():.5f}", *apart,
        ))  # fmt: skip
    return ReportTable(
        caption="Random formations of dipoles of 0.05 m (0.5 m, 10 degrees). A dipole far smaller than the "
        "wavelength is nearly a capacitor: its input power is determined by a small resistance in series "
        "with a large reactance, and their ratio decreases with the cube of the wavelength. In addition "
        "NEC2's basis of constant, sine and cosine on a segment loses digits, because constant and cosine "
        "become equal with the square of the segment length over the wavelength. The average gains of both "
        "NEC2 programs therefore scatter independently, about as the fifth power of the wavelength and the "
        "square of the number of segments. The batch solver does this arithmetic once for each kind of "
        "element, and couples elements by moments of their currents. The field is correct in all solvers: "
        "directivity, the gain over the average gain, agrees, and is the quantity to compare:",
        columns=("wavelength m", "segments", "resistance/reactance", "solver", "formations", "average gain",
                 "deviation", "maximum less batch: greatest dB", "directivity: greatest dB"),
        rows=tuple(rows),
    )  # fmt: skip

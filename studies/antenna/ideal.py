"""The ideal array: two NEC2 programs and the batch solver, closed forms and reference results."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from msgspec import Struct

from antenna.analysis.features import features
from antenna.analysis.gain_figures import patterns_figure
from antenna.analysis.patterns import Pattern
from antenna.lab.formations import ideal
from antenna.lab.hertzian import hertzian_pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, ElementsTouch, Snapshot, grid, upright
from antenna.solvers.ports import MAIN_LOBE_DEG, feed
from studies.antenna.checks import deviation, difference, row, said_missing, solve, worst
from studies.antenna.closed_form import (
    directivity_dbi,
    hertzian_coupling,
    isotropic_coupling,
    policy_voltages,
)
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results

SOLVERS = ("nec2", "nec2c", "batch")
WAVELENGTHS_M = (5.0, 7.5, 10.0, 15.0, 20.0)
GRID_DEG = 2.0
NEC2_DBI, EXACT_DBI, TOLERANCE_DB = 13.26, 13.280, 0.01
POINTING_DEG = 0.2
AZIMUTH_DEG, ELEVATION_DEG, WIDTH_TOLERANCE_DEG = 15.4, 87.2, 0.3
"""Widths of the closed form, about 15 and 87 degrees"""
SIDE_LOBE_DBI, SIDE_LOBE_TOLERANCE_DB = 4.9, 0.05
DEEP_NULL_DBI = -50.0
"""Uncoupled rows a quarter wavelength apart, fed in quadrature, do not radiate to -y."""
LONG_DBI = {20.0: (13.40, 0.005), 10.0: (13.60, 0.005), 5.0: (15.6, 0.05)}
"""Dipoles of 5 m by wavelength: reference and its rounding."""
LONG_RADII_M = (0.001, 0.003)
REFERENCE_RADIUS_M = 0.003
"""The reference states no radius; this one, found by trial, reproduces its three values."""
LAYOUTS = {"4x2": 4, "2x4": 2}
"""Columns of eight places, 0.85 wavelengths apart; rows 0.25."""
POLICIES = ("end_fire", "hansen_woodyard", "best_step", "optimum")
REFERENCE_DBI = {
    ("4x2 isotropic", "end_fire"): 10.744, ("4x2 isotropic", "hansen_woodyard"): 11.435,
    ("4x2 isotropic", "best_step"): 12.174, ("4x2 isotropic", "optimum"): 12.190,
    ("4x2", "end_fire"): 13.280, ("4x2", "hansen_woodyard"): 12.708,
    ("4x2", "best_step"): 13.915, ("4x2", "optimum"): 13.945,
    ("2x4", "end_fire"): 11.037, ("2x4", "hansen_woodyard"): 12.332,
    ("2x4", "best_step"): 12.399, ("2x4", "optimum"): 14.128,
}  # fmt: skip
ROUNDING_DB = 0.0006
"""Rounding of a reference with three decimals."""
WIRES_DB = 0.003
"""Difference allowed between NEC2's directivity of short dipoles of finite length and the closed form."""


class Solved(Struct, frozen=True, kw_only=True):
    """Result of a solver for an ideal array; with the pattern if it is drawn."""

    max_gain_dbi: float
    theta_deg: float
    phi_deg: float
    average_gain: float
    azimuth_deg: float
    elevation_deg: float
    side_lobe_dbi: float
    back_dbi: float
    pattern: Pattern | None = None

    @property
    def directivity_dbi(self) -> float:
        """Gain over average gain."""
        return self.max_gain_dbi - 10.0 * math.log10(self.average_gain)


def places(columns: int, wavelength_m: float) -> Array:
    """Return the places (8, 3) of an ideal formation."""
    return grid(8, columns, 0.85 * wavelength_m, 0.25 * wavelength_m)


def short_config(wavelength_m: float, solver: str) -> AntennaConfig:
    """Return the configuration with 13.26 dBi: 0.05 m, 0.2 mm, nine segments."""
    return AntennaConfig(wavelength_m=wavelength_m, backend=solver, grid_deg=GRID_DEG)  # type: ignore[arg-type]


def long_config(wavelength_m: float, radius_m: float, solver: str) -> AntennaConfig:
    """Return the configuration of dipoles of 5 m."""
    return AntennaConfig(
        wavelength_m=wavelength_m, backend=solver, grid_deg=GRID_DEG,  # type: ignore[arg-type]
        element_length_m=5.0, element_radius_m=radius_m, segments=11,
    )  # fmt: skip


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:  # noqa: ARG001  # common signature
    """Return the jobs of all arrays, which do not depend on the plan."""
    return {
        "short": [partial(_solve_ideal, short_config(w, s)) for w, s in product(WAVELENGTHS_M, SOLVERS)],
        "long": [
            partial(_solve_ideal, long_config(*one)) for one in product(LONG_DBI, LONG_RADII_M, SOLVERS)
        ],
        "policies": [partial(_solve_policy, *one) for one in product(LAYOUTS, POLICIES, SOLVERS)],
    }


def _solve_ideal(config: AntennaConfig) -> Solved | None:
    return _solve(ideal(places(4, config.wavelength_m), config), config)


def _solve_policy(layout: str, policy: str, solver: str) -> Solved | None:
    """Solve short dipoles at 10 m with the voltages of a policy; the optimum includes mutual coupling."""
    config = AntennaConfig(backend=solver)  # type: ignore[arg-type]
    places_m = places(LAYOUTS[layout], config.wavelength_m)
    if policy == "optimum":
        voltages = feed(places_m, AntennaConfig(excitation="optimum"))
    else:
        coupling = hertzian_coupling(places_m, config.wavelength_m)
        voltages = policy_voltages(policy, coupling, places_m, config.wavelength_m)
    return _solve(upright(places_m, voltages), config)


def _solve(snapshot: Snapshot, config: AntennaConfig) -> Solved | None:
    """Solve one array without touching elements; None if the solver is not installed."""
    found = solve(snapshot, config)
    if isinstance(found, ElementsTouch):
        raise found
    return None if found is None else summary(found, keep=config == short_config(10.0, config.backend))


def summary(pattern: Pattern, *, keep: bool) -> Solved:
    """Return the features of a pattern; a missing one is NaN, which fails every check."""
    found = features(pattern)

    def number(value: float | None) -> float:
        return math.nan if value is None else value

    return Solved(
        max_gain_dbi=pattern.max_gain_dbi, theta_deg=pattern.max_theta_deg, phi_deg=pattern.max_phi_deg,
        average_gain=pattern.average_gain, azimuth_deg=number(found.azimuth_width_deg),
        elevation_deg=number(found.elevation_width_deg), side_lobe_dbi=number(found.side_lobe_dbi),
        back_dbi=found.back_dbi, pattern=pattern if keep else None,
    )  # fmt: skip


def judge(plan: AntennaPlan, results: Results) -> Section:  # noqa: ARG001  # common signature
    """Compare all arrays with their references."""
    short = dict(zip(product(WAVELENGTHS_M, SOLVERS), results["short"], strict=True))
    long = dict(zip(product(LONG_DBI, LONG_RADII_M, SOLVERS), results["long"], strict=True))
    policies = dict(zip(product(LAYOUTS, POLICIES, SOLVERS), results["policies"], strict=True))
    checks, table = _of_short_dipoles(short)
    more, wires = _of_long_dipoles(long)
    last, feeds = _of_policies(policies)
    drawn = {s: short[10.0, s].pattern for s in ("nec2", "batch") if short[10.0, s] is not None}
    figure = ReportFigure(
        "antenna-ideal.png", "pattern of the ideal formation by both solvers", partial(_draw, drawn)
    )
    absent = [s for _, s in short if short[10.0, s] is None]
    return Section(
        title="The ideal array",
        conditions=(
            "Eight upright dipoles in free space, four columns 0.85 wavelengths apart along x and two rows "
            "0.25 wavelengths apart along y, fed with exp(-j k y). Short dipoles have a length of 0.05 m, a "
            "radius of 0.2 mm and nine segments. Exact is the closed form for Hertzian dipoles. NEC2's "
            "segmentation reduces the gain of short dipoles by 0.018 dB, its average gain (radiated over "
            "input power); directivity is gain over average gain. Widths and lobes are taken from a grid of "
            f"{GRID_DEG:g} degrees. The reference values are from other programs, with PyNEC 2.3.4 and "
            "nec2c 1.3.\n" + said_missing(absent)
        ),
        checks=(*checks, *more, *last),
        tables=(table, wires, feeds),
        figures=(figure,) if drawn else (),
    )


def _draw(patterns: Mapping[str, Pattern], path: Path) -> None:
    patterns_figure(patterns).savefig(path, format="png", dpi=80)


def _of_short_dipoles(short: dict[tuple[float, str], Solved | None]) -> tuple[list[Check], ReportTable]:
    checks, rows = [], []
    found: dict[str, list[Solved]] = {name: [] for name in ("exact", *SOLVERS)}
    for wavelength_m in WAVELENGTHS_M:
        config = AntennaConfig(wavelength_m=wavelength_m, grid_deg=GRID_DEG)
        array = ideal(places(4, wavelength_m), config)
        exact = summary(hertzian_pattern(array, wavelength_m, grid_deg=GRID_DEG), keep=False)
        for name, one in (("exact", exact), *((s, short[wavelength_m, s]) for s in SOLVERS)):
            if one is None:
                continue
            expected_dbi = EXACT_DBI if name == "exact" else NEC2_DBI
            title = f"{name}, {wavelength_m:g} m: maximum"
            checks.append(deviation(title, one.max_gain_dbi, expected_dbi, TOLERANCE_DB, "dB"))
            found[name].append(one)
            rows.append(_numbers(name, wavelength_m, one))
    for name, all_of_it in found.items():
        if all_of_it:
            checks += _shape(name, all_of_it)
    columns = (
        "solver", "wavelength m", "maximum dBi", "theta °", "phi °", "average gain", "directivity dBi",
        "azimuth °", "elevation °", "side lobe dBi", "to -y dBi",
    )  # fmt: skip
    return checks, ReportTable(caption="Short dipoles:", columns=columns, rows=tuple(rows))


def _shape(name: str, found: Sequence[Solved]) -> list[Check]:
    """Return the checks of features that are equal at all wavelengths; the worst value counts."""
    return [
        difference(
            f"{name}: {what}, less {expected:g}, at worst",
            worst(value(one) - expected for one in found), tolerance, unit,
        )
        for what, value, expected, tolerance, unit in (
            ("directivity", lambda one: one.directivity_dbi, EXACT_DBI, TOLERANCE_DB, "dB"),
            ("main lobe from +y", from_main_lobe_deg, 0.0, POINTING_DEG, "°"),
            ("azimuth half-power width", lambda one: one.azimuth_deg, AZIMUTH_DEG, WIDTH_TOLERANCE_DEG, "°"),
            ("elevation half-power width", lambda one: one.elevation_deg, ELEVATION_DEG,
             WIDTH_TOLERANCE_DEG, "°"),
            ("side lobe", lambda one: one.side_lobe_dbi, SIDE_LOBE_DBI, SIDE_LOBE_TOLERANCE_DB, "dB"),
        )
    ] + [
        Check(
            f"{name}: gain to -y, greatest", max(one.back_dbi for one in found), "dBi", at_most=DEEP_NULL_DBI
        )
    ]  # fmt: skip


def _numbers(name: str, wavelength_m: float, of: Solved) -> tuple[str, ...]:
    return (
        name, f"{wavelength_m:g}", f"{of.max_gain_dbi:.4f}", f"{of.theta_deg:.2f}", f"{of.phi_deg:.2f}",
        f"{of.average_gain:.5f}", f"{of.directivity_dbi:.4f}", f"{of.azimuth_deg:.2f}",
        f"{of.elevation_deg:.2f}", f"{of.side_lobe_dbi:.3f}", f"{of.back_dbi:.0f}",
    )  # fmt: skip


def from_main_lobe_deg(found: Solved) -> float:
    """Return the angle between the maximum and +y, from the chord."""

    def unit(theta_deg: float, phi_deg: float) -> Array:
        theta, phi = math.radians(theta_deg), math.radians(phi_deg)
        return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])

    chord = np.linalg.norm(unit(found.theta_deg, found.phi_deg) - unit(*MAIN_LOBE_DEG))
    return math.degrees(2.0 * math.asin(min(float(chord) / 2.0, 1.0)))


def _of_long_dipoles(long: dict[tuple[float, float, str], Solved | None]) -> tuple[list[Check], ReportTable]:
    checks, rows = [], []
    for wavelength_m, radius_m in product(LONG_DBI, LONG_RADII_M):
        reference_dbi, tolerance_db = LONG_DBI[wavelength_m]
        solved = [long[wavelength_m, radius_m, solver] for solver in SOLVERS]
        for solver, found in zip(SOLVERS, solved, strict=True):
            if found is not None and radius_m == REFERENCE_RADIUS_M:
                name = f"{solver}, dipole 5 m, {wavelength_m:g} m: maximum"
                checks.append(deviation(name, found.max_gain_dbi, reference_dbi, tolerance_db, "dB"))
        gains = [None if found is None else found.max_gain_dbi for found in solved]
        average = None if solved[0] is None else solved[0].average_gain
        rows.append(row(f"{wavelength_m:g}", f"{1e3 * radius_m:g}", f"{reference_dbi:g}", *gains, average))
    return checks, ReportTable(
        caption="Dipoles of 5 m, 11 segments, maximum in dBi; equal voltages do not cause equal currents. "
        f"The reference does not state its wire radius; {1e3 * REFERENCE_RADIUS_M:g} mm was chosen because "
        "it reproduces all its values, so these check the solvers in common but not individually:",
        columns=("wavelength m", "radius mm", "reference", *SOLVERS, "average gain of nec2"),
        rows=tuple(rows),
    )


def _of_policies(policies: dict[tuple[str, str, str], Solved | None]) -> tuple[list[Check], ReportTable]:
    checks, rows, wavelength_m = [], [], 10.0
    apart_db: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
    for (kind, policy), reference_dbi in REFERENCE_DBI.items():
        layout, wired = kind.split()[0], "isotropic" not in kind
        places_m = places(LAYOUTS[layout], wavelength_m)
        coupling = (hertzian_coupling if wired else isotropic_coupling)(places_m, wavelength_m)
        voltages = policy_voltages(policy, coupling, places_m, wavelength_m)
        exact_dbi = directivity_dbi(voltages, coupling, places_m, wavelength_m)
        name = f"{kind}, {policy}"
        checks.append(deviation(f"{name}: exact", exact_dbi, reference_dbi, ROUNDING_DB, "dB"))
        solved = [policies[layout, policy, solver] if wired else None for solver in SOLVERS]
        for solver, found in zip(SOLVERS, solved, strict=True):
            if found is not None:
                apart_db[solver].append(found.directivity_dbi - exact_dbi)
        gains = [None if found is None else found.max_gain_dbi for found in solved]
        rows.append(row(kind, policy, f"{reference_dbi:.3f}", exact_dbi, *gains))
    for solver, errors_db in apart_db.items():
        if errors_db:
            name = f"all policies: {solver}'s directivity, less the exact, at worst"
            checks.append(difference(name, worst(errors_db), WIRES_DB, "dB"))
    return checks, ReportTable(
        caption="Feeding policies, 10 m: directivity along +y in closed form; solvers' maximum gain, dBi:",
        columns=("formation", "policy", "reference", "exact", *SOLVERS),
        rows=tuple(rows),
    )

"""Tests of the antenna's validation: closed forms, a small part of each subject, failing checks (8 s)."""

import csv
import json
import math
import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from antenna_checks import PLAN, missed
from msgspec.structs import replace
from typer.testing import CliRunner

from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, grid
from antenna.solvers.interface import BackendUnavailable
from studies.antenna import agreement, checks, cli, ideal, limits, sensitivity, speed
from studies.antenna.checks import worst
from studies.antenna.closed_form import (
    directivity_dbi,
    hertzian_coupling,
    isotropic_coupling,
    policy_voltages,
)
from studies.antenna.plan import QUICK_ANTENNA, AntennaPlan
from studies.common.report import Check, ReportFigure, ReportTable, Section, draw_figures
from studies.common.runner import Subject

LAMBDA_M = 10.0
needs_nec2 = pytest.mark.nec2


@pytest.fixture
def _pynec():
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")


# ---- arithmetic


def test_worst_is_the_largest_magnitude_or_nan():
    assert worst([0.1, -0.3, 0.2]) == -0.3
    assert math.isnan(worst([]))
    assert math.isnan(worst([0.1, math.nan]))


def test_isotropic_elements_half_a_wavelength_apart_are_uncoupled():
    """sin(pi) / pi is 0, so n elements in phase across the direction have n times the gain: 3.01 dB for two.

    A quarter wavelength apart along +y and in quadrature the mutual power is proportional to cos(pi / 2): the
    same.
    """
    for places_m in (grid(2, 2, LAMBDA_M / 2, 0.0), grid(2, 1, 0.0, LAMBDA_M / 4)):
        coupling = isotropic_coupling(places_m, LAMBDA_M)
        voltages = policy_voltages("end_fire", coupling, places_m, LAMBDA_M)
        assert directivity_dbi(voltages, coupling, places_m, LAMBDA_M) == pytest.approx(
            10.0 * math.log10(2.0)
        )


def test_hertzian_dipole_has_a_directivity_of_three_halves():
    places_m = np.zeros((1, 3))
    coupling = hertzian_coupling(places_m, LAMBDA_M)
    assert coupling[0, 0] == pytest.approx(2.0 / 3.0)  # the mean of sin^2
    assert directivity_dbi(np.ones(1, complex), coupling, places_m, LAMBDA_M) == pytest.approx(
        10.0 * math.log10(1.5)
    )


@pytest.mark.parametrize("couple", [isotropic_coupling, hertzian_coupling])
@pytest.mark.parametrize("columns", [4, 2])
def test_more_general_policies_have_more_gain(couple, columns):
    """The best lag includes those of end fire and Hansen-Woodyard, and the optimum includes it."""
    places_m = ideal.places(columns, LAMBDA_M)
    coupling = couple(places_m, LAMBDA_M)
    assert np.abs(coupling - coupling.T).max() < 1e-12
    gains = {
        policy: directivity_dbi(
            policy_voltages(policy, coupling, places_m, LAMBDA_M), coupling, places_m, LAMBDA_M
        )
        for policy in ideal.POLICIES
    }
    assert gains["optimum"] > gains["best_step"] > max(gains["end_fire"], gains["hansen_woodyard"])
    with pytest.raises(ValueError, match="superb"):
        policy_voltages("superb", coupling, places_m, LAMBDA_M)


def test_standard_errors_of_normal_gains():
    """For K normal numbers s / sqrt(K) and s / sqrt(2 K), as in 400 samples of 200 numbers."""
    samples = np.random.default_rng(3).normal(11.0, 0.8, (400, 200))
    found = [sensitivity.moments(sample) for sample in samples]
    assert np.std([one.mean_dbi for one in found]) == pytest.approx(0.8 / math.sqrt(200), rel=0.1)
    assert np.mean([one.mean_error_db for one in found]) == pytest.approx(0.8 / math.sqrt(200), rel=0.05)
    assert np.mean([one.std_error_db for one in found]) == pytest.approx(0.8 / math.sqrt(400), rel=0.05)
    assert sensitivity.moments(np.full(5, 13.0)).std_error_db == 0.0


# ---- the ideal array


def ideal_results():
    """Solve short dipoles at one wavelength and one policy by two solvers; other results are missing."""
    selected = {
        "short": lambda config: config.wavelength_m == LAMBDA_M,
        "long": lambda _: False,
        "policies": lambda *one: one[:2] == ("2x4", "hansen_woodyard") and one[2] != "nec2c",
    }
    return {
        group: [job() if selected[group](*job.args) else None for job in jobs]
        for group, jobs in ideal.jobs(PLAN).items()
    }


@needs_nec2
@pytest.mark.usefixtures("_pynec")
def test_ideal_array_meets_all_checks_and_wrong_ones_fail(tmp_path):
    results = ideal_results()
    section = ideal.judge(PLAN, results)
    assert missed(section) == []
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).exists()
    names = " ".join(one.name for one in section.checks)
    assert all(f"{solver}, 10 m" in names for solver in ("nec2", "batch", "exact"))

    def wrong(**fields):
        changed = {
            group: [None if one is None else replace(one, **fields) for one in found]
            for group, found in results.items()
        }
        return missed(ideal.judge(PLAN, changed))

    assert any("maximum" in name for name in wrong(max_gain_dbi=13.28))
    assert any("all policies" in name for name in wrong(average_gain=0.99))
    assert any("main lobe" in name for name in wrong(phi_deg=270.0))
    assert any("azimuth" in name for name in wrong(azimuth_deg=16.0))
    assert any("elevation" in name for name in wrong(elevation_deg=math.nan))
    assert any("side lobe" in name for name in wrong(side_lobe_dbi=5.1))
    assert any("-y" in name for name in wrong(back_dbi=-20.0))


def test_long_dipoles_are_compared_with_their_reference():
    results = {group: [None] * len(jobs) for group, jobs in ideal.jobs(PLAN).items()}
    requested = ideal.jobs(PLAN)["long"]
    right = ideal.Solved(
        max_gain_dbi=13.60, theta_deg=90.0, phi_deg=90.0, average_gain=1.0, azimuth_deg=15.0,
        elevation_deg=87.0, side_lobe_dbi=5.0, back_dbi=0.0,
    )  # fmt: skip
    for gain_dbi, expected in ((13.60, 0), (13.61, 3)):
        results["long"] = [
            replace(right, max_gain_dbi=gain_dbi) if job.args[0].wavelength_m == LAMBDA_M else None
            for job in requested
        ]
        section = ideal.judge(PLAN, results)
        assert sum("5 m, 10 m" in one.name for one in section.checks) == 3
        assert len([name for name in missed(section) if "dipole 5 m" in name]) == expected
    assert "Not installed, therefore without a row: batch, nec2, nec2c" in section.conditions


# ---- batch against NEC2


@needs_nec2
@pytest.mark.usefixtures("_pynec")
@pytest.mark.parametrize("case", [agreement.CASES[0], agreement.CASES[1]], ids=lambda case: case.name)
def test_few_formations_are_within_their_limits(case):
    found = agreement.compare(case, "batch", count=5)
    assert len(found.maximum_db) == len(found.pattern_db) == len(found.average_gain) == 5
    assert missed(agreement.requirements(case.name, found)) == []
    # one formation slightly above the limit fails
    for field, limit_db in zip(("maximum_db", "pattern_db"), found.limits_db, strict=True):
        worse = (*getattr(found, field)[:-1], -1.01 * limit_db)
        names = missed(agreement.requirements(case.name, replace(found, **{field: worse})))
        assert len(names) == 1
        assert field.removesuffix("_db") in names[0]


def flat_pattern(gain_dbi, average_gain=1.0):
    grids = np.full((37, 72), gain_dbi)
    return Pattern(
        theta_deg=np.linspace(0.0, 180.0, 37), phi_deg=np.linspace(0.0, 355.0, 72),
        theta_gain_dbi=grids, phi_gain_dbi=np.full((37, 72), -999.99), max_gain_dbi=gain_dbi,
        max_theta_deg=90.0, max_phi_deg=90.0, average_gain=average_gain, backend="made up",
    )  # fmt: skip


def test_differences_are_relative_to_nec2_and_separate_power_from_directivity():
    """Gains are 0.1 dB higher because of 2.3 % more radiated power: directivity is equal."""
    higher = flat_pattern(10.1, 10.0**0.01)
    found = agreement.differences([higher], [flat_pattern(10.0)], (0.01, 0.1), redrawn=3)
    assert found.maximum_db == pytest.approx((0.1,))
    assert found.pattern_db == pytest.approx((0.1,))
    assert found.directivity_db == pytest.approx((0.0,), abs=1e-12)
    assert found.redrawn == 3
    for by_directivity, first in ((False, ["made up: maximum"]), (True, [])):
        names = missed(agreement.requirements("made up", found, by_directivity=by_directivity))
        assert [name for name in names if "pattern" not in name] == first


def test_patterns_are_compared_where_nec2_has_gain():
    nec2_dbi = np.array([[10.0, -19.9], [-20.1, -60.0]])
    ours_dbi = nec2_dbi + np.array([[0.0, -0.2], [3.0, 9.0]])
    assert agreement.greatest_difference_db(ours_dbi, nec2_dbi) == pytest.approx(-0.2)
    assert math.isnan(agreement.greatest_difference_db(nec2_dbi - 90.0, nec2_dbi - 90.0))


def test_formations_that_touch_for_one_solver_only_are_reported():
    pattern, touch = flat_pattern(10.0), ElementsTouch(0, 1, 0.0)
    same = agreement.differences([pattern, touch], [pattern, touch], (0.01, 0.1), redrawn=0)
    assert (same.touching, same.disagreeing, len(same.maximum_db)) == (1, 0, 1)
    assert missed(agreement.requirements("made up", same)) == []
    other = agreement.differences([pattern, touch], [pattern, pattern], (0.01, 0.1), redrawn=0)
    assert "alone" in " ".join(missed(agreement.requirements("made up", agreement.together([same, other]))))


def test_case_without_a_comparison_fails():
    touch = ElementsTouch(0, 1, 0.0)
    nothing = agreement.differences([touch], [touch], (0.01, 0.1), redrawn=0)
    assert len(missed(agreement.requirements("made up", nothing))) == 2


def test_formations_are_drawn_with_the_required_wire_distance():
    crowded = replace(agreement.CASES[1], sigma_m=1.5, least_apart_m=1.0)
    element = crowded.config.element()
    snapshots, redrawn = agreement.formations(crowded, seed=2, count=20)
    assert len(snapshots) == 20
    assert redrawn > 0
    assert min(agreement.least_apart_m(one, element) for one in snapshots) >= 1.0
    loose, none = agreement.formations(replace(crowded, least_apart_m=0.0), seed=2, count=20 + redrawn)
    assert none == 0
    assert sum(agreement.least_apart_m(one, element) < 1.0 for one in loose) == redrawn


def test_missing_solver_is_reported_and_fails_no_check(monkeypatch):
    def unavailable(config):
        raise BackendUnavailable(f"no {config.backend}")

    monkeypatch.setattr(checks, "make_backend", unavailable)
    results = {group: [job() for job in jobs] for group, jobs in agreement.jobs(PLAN).items()}
    section = agreement.judge(PLAN, results)
    assert section.checks == ()
    assert "Not installed" in section.conditions
    section = limits.judge(
        PLAN, {group: [job() for job in jobs] for group, jobs in limits.jobs(PLAN).items()}
    )
    assert missed(section) == []
    assert "nec2c" in section.conditions


# ---- position errors


def test_draws_agree_with_the_reference_and_other_deviations_do_not():
    """1000 draws at 0.5 m and 10 m: 12.62 and 0.28 dB; at 0.25 m it would be 13.09, at 1 m 11.04."""
    row = next(r for r in sensitivity.reference_rows() if (r.sigma_m, r.wavelength_m) == (0.5, LAMBDA_M))
    config = AntennaConfig(grid_deg=sensitivity.GRID_DEG)
    for sigma_m, right in ((0.5, True), (0.25, False), (1.0, False)):
        gains = sensitivity.draw(config, sigma_m=sigma_m, samples=100)
        # the grid has single precision
        assert all(a >= b - 1e-5 for a, b in zip(gains.refined, gains.on_grid, strict=True))
        ours = sensitivity.moments(np.array(gains.on_grid))
        assert (missed(sensitivity.compared("row", ours, row)) == []) == right


def test_gain_depends_on_the_ratio_of_deviation_and_wavelength():
    rows = [r for r in sensitivity.reference_rows() if r.sigma_m / r.wavelength_m in {0.05, 0.1}]
    gains = [
        sensitivity.draw(AntennaConfig(wavelength_m=row.wavelength_m), sigma_m=row.sigma_m, samples=6)
        for row in rows
    ]
    assert len(rows) == 5
    assert 0.0 < sensitivity.alike_db(rows, gains) < sensitivity.SAME_DB
    moved = replace(gains[0], refined=tuple(value + 0.05 for value in gains[0].refined))
    assert sensitivity.alike_db(rows, [moved, *gains[1:]]) > sensitivity.SAME_DB


def test_every_row_of_the_reference_is_checked(tmp_path):
    """Gains drawn with the table's moments pass; with a changed mean or spread of a row they fail."""
    rows, rng = sensitivity.reference_rows(), np.random.default_rng(6)
    unit = rng.standard_normal(400)
    unit = (unit - unit.mean()) / unit.std(ddof=1)

    def results(shift_db=0.0, stretch=1.0):
        def gains(mean, std):
            values = tuple((mean + shift_db + stretch * std * unit).tolist())
            return sensitivity.Gains(refined=values, on_grid=values, touching=0)

        return {
            "table": [gains(r.mean_max_gain_dbi, r.std_db) for r in rows],
            "feeds": [gains(mean, 0.3) for mean in sensitivity.FEEDS_DBI.values()],
            "curve": [gains(12.0, 0.3) for _ in sensitivity.CURVE_LAMBDA],
            "grids": [gains(12.0, 0.3) for _ in sensitivity.GRIDS_DEG],
        }

    right = sensitivity.judge(PLAN, results())
    assert missed(right) == []
    draw_figures([right], tmp_path)
    assert (tmp_path / right.figures[0].file_name).exists()
    assert len(missed(sensitivity.judge(PLAN, results(shift_db=-0.3)))) == len(rows) + 3
    spread = missed(sensitivity.judge(PLAN, results(stretch=2.5)))
    assert all("deviation" in name for name in spread)
    assert len(spread) >= 7  # a deviation of 0.03 dB may grow before it differs by 0.05 dB


# ---- speed


def test_speed_is_checked_by_benchmark_fields_and_a_missing_field_fails():
    good = {"speedup_short_dipole": 200.0, "speedup_5m_dipole": 40.0, "speedup_two_cores": 1.7}
    section = speed.judge(PLAN, {"benchmark": [good | {"more": {"us": 12.5, "rounds": 3}}]})
    assert missed(section) == []
    assert ("more.us", "12.5") in section.tables[0].rows
    for name, least in good.items():
        assert missed(speed.requirements(good | {name: least * 0.99})) == [name]
        assert missed(speed.requirements({k: v for k, v in good.items() if k != name})) == [name]
    without = speed.judge(PLAN, {"benchmark": [None]})
    assert without.checks == without.tables == ()
    assert "PyNEC" in without.conditions


# ---- the program


def test_subjects_have_picklable_jobs_and_a_quick_plan_has_fewer():
    for module in (ideal, agreement, sensitivity, limits, speed):
        quick, full = (
            [job for group in module.jobs(plan).values() for job in group]
            for plan in (QUICK_ANTENNA, AntennaPlan())
        )
        assert 0 < len(quick) <= len(full)
        assert pickle.dumps(full)


def test_unknown_subject_is_a_one_line_error():
    result = CliRunner().invoke(cli.validate_antenna_app, ["--only", "ideal,nonsense"])
    assert result.exit_code == 2
    assert result.stderr.count("\n") <= 2
    assert "nonsense" in result.stderr


@pytest.mark.parametrize(("at_most", "status"), [(2.0, 0), (1.9, 1)])
def test_page_table_and_exit_status_follow_the_checks(monkeypatch, tmp_path, at_most, status):
    """A subject whose one job is the square root of 4."""

    def judge(plan, results):
        assert plan == QUICK_ANTENNA
        return Section(
            title="Roots", conditions="Of four.\n",
            checks=(Check(name="root", value=results["roots"][0], unit="m", at_most=at_most),),
            tables=(ReportTable(caption="All:", columns=("of",), rows=(("4",),)),),
            figures=(ReportFigure("roots.png", "a figure", Path.touch),),
        )  # fmt: skip

    roots = Subject(lambda _: {"roots": [partial(math.sqrt, 4.0)]}, judge)
    monkeypatch.setattr(cli, "VALIDATION", replace(cli.VALIDATION, subjects={"ideal": roots}))
    result = CliRunner().invoke(
        cli.validate_antenna_app, ["--only", "ideal", "--quick", "--json", "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == status, result.output
    (number,) = json.loads(result.stdout)["checks"]
    assert (number["section"], number["value"], number["met"]) == ("Roots", 2.0, status == 0)
    page = (tmp_path / "out" / "antenna-validation.md").read_text(encoding="utf-8")
    assert page.startswith("# Validation of the antenna\n")
    assert "![a figure](images/roots.png)" in page
    assert (tmp_path / "out" / "images" / "roots.png").exists()
    with (tmp_path / "out" / "antenna-validation.csv").open(encoding="utf-8", newline="") as file:
        (line,) = csv.DictReader(file)
    assert (line["name"], float(line["value"]), line["met"]) == ("root", 2.0, str(status == 0))

"""Tests of the vehicle's validation: verdicts, page, command lines, allocation; the benchmark (20 s)."""

import json
import math
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from paths import ROOT
from scipy.optimize import linprog
from typer.testing import CliRunner

from autopilot.control.mixing import effectiveness
from autopilot.control.params import AllocationParams
from foundation.exit_status import BAD_INPUT
from harness.world.sensors.config import PROFILES
from studies.common.report import (
    Check,
    ReportFigure,
    ReportTable,
    Section,
    figures_folder,
    figures_link,
    markdown,
    write_csv,
)
from studies.common.runner import run_subjects
from studies.vehicle import estimation_section
from studies.vehicle.allocation import RANGE_N, _is_achievable, check_allocation
from studies.vehicle.bench import _PARTS, _StopWatch, measure, record_flight
from studies.vehicle.cli import SUBJECTS, validate_app
from studies.vehicle.estimation import EPOCH_S, MEASUREMENTS, STATES, Consistency, WrongCompass, pooled
from studies.vehicle.hover import Hover, fly_hover
from studies.vehicle.hover_section import unobservable_tilt_deg
from studies.vehicle.plan import QUICK

SCRIPT = ROOT / "scripts" / "validate_vehicle.py"


def check(value, **bounds):
    return Check(name="rms", value=value, unit="m", **bounds)


def test_verdicts():
    assert check(0.2, at_most=0.2).passed
    assert not check(0.2001, at_most=0.2).passed
    assert check(0.1, at_least=0.1, at_most=0.2).passed
    assert not check(0.05, at_least=0.1, at_most=0.2).passed
    assert not check(math.nan, at_most=0.2).passed
    assert not check(math.nan, at_least=0.2).passed
    assert not check(math.inf, at_most=1e9).passed


def test_page():
    section = Section(
        title="Hover",
        conditions="In wind.\n",
        checks=(check(0.12345, at_most=0.2), replace(check(3.0, at_least=0.1, at_most=0.2), px4="0.18 m")),
        tables=(ReportTable(caption="More:", columns=("a", "b"), rows=(("1", "2"),)),),
        figures=(ReportFigure("x.png", "a figure", Path.touch),),
    )
    page = markdown([section], introduction="All of it.\n")
    assert "| what | measured | PX4 | required | met |\n" in page
    assert "| rms | 0.123 m |  | at most 0.2 | yes |\n" in page
    assert "| rms | 3 m | 0.18 m | 0.1 to 0.2 | **no** |\n" in page
    assert "| a | b |\n| --- | --- |\n| 1 | 2 |\n" in page
    assert page.endswith("![a figure](images/x.png)\n")


def test_figures_are_in_the_shared_folder_if_it_exists(tmp_path):
    out = tmp_path / "docs" / "results"
    assert figures_folder(out) == out / "images"
    assert figures_link(out) == "images"
    (tmp_path / "docs" / "images").mkdir(parents=True)
    assert figures_folder(out) == tmp_path / "docs" / "images"
    assert figures_link(out) == "../images"
    figure = ReportFigure("x.png", "a figure", Path.touch)
    section = Section(title="Hover", conditions="", checks=(), figures=(figure,))
    page = markdown([section], introduction="", figures=figures_link(out))
    assert page.endswith("![a figure](../images/x.png)\n")


def test_tables_have_six_digits_and_empty_cells(tmp_path):
    rows = [["x", 1.23456789, math.nan, None, 7]]
    write_csv(tmp_path / "new" / "a.csv", ("name", "value", "nan", "none", "count"), rows)
    assert (tmp_path / "new" / "a.csv").read_bytes() == b"name,value,nan,none,count\nx,1.23457,,,7\n"
    write_csv(tmp_path / "b.csv", ("value",), [[1.23456789]], all_digits=True)
    assert (tmp_path / "b.csv").read_bytes() == b"value\n1.23456789\n"


def test_achievable_torques_agree_with_a_linear_programme():
    rng = np.random.default_rng(4)
    levers = effectiveness(AllocationParams())[1:3] * RANGE_N
    torques = rng.uniform(-3.5, 3.5, (150, 2))
    found = [
        linprog(np.zeros(4), A_eq=levers, b_eq=torque, bounds=[(0.0, 1.0)] * 4).success for torque in torques
    ]
    assert 20 < sum(found) < 130
    np.testing.assert_array_equal(_is_achievable(torques, levers), found)


def test_allocation_of_random_demands():
    worst = check_allocation(3000, seed=2)
    assert 300 < worst.achievable < 1500
    assert worst.lowest_control >= 0.0
    assert worst.highest_control <= 1.0
    assert max(worst.lost_torque_n_m, worst.turned_rad, worst.misreported_n_m, worst.added_thrust) < 1e-9


def test_subjects_are_judged_by_the_results_of_their_jobs():
    """Only allocation is fast; the jobs of the other subjects must be picklable."""
    seen = []
    judged = run_subjects(
        replace(QUICK, demands=500),
        {"allocation": SUBJECTS["allocation"]},
        progress=lambda *counts: seen.append(counts),
    )
    assert seen == [("allocation", 1, 1)]
    assert all(one.passed for one in judged["allocation"].checks)
    for subject in SUBJECTS.values():
        jobs = [job for group in subject.jobs(QUICK).values() for job in group]
        assert jobs
        assert pickle.dumps(jobs)


def drawn_campaign(seed, *, overconfidence=1.0, runs=20, epochs=90):
    """Draw independent errors of a filter that is consistent or overconfident."""
    rng = np.random.default_rng(seed)
    square = (rng.standard_normal((len(STATES), runs, epochs, 3)) ** 2).sum(axis=3) * overconfidence**2
    return Consistency(
        time_s=EPOCH_S * np.arange(epochs),
        nees=dict(zip(STATES, square, strict=True)),
        innovations={name: list(rng.standard_normal((runs, 300, 2))) for name in MEASUREMENTS},
        refused=0,
    )


def nees_checks(campaigns):
    compass = WrongCompass(caught_s=2.0, heading_error_rad=0.0, resets=1)
    results = {"consistency": campaigns, "outage": [1.0], "compass": [compass]}
    section = estimation_section.judge(QUICK, results)
    return [one for one in section.checks if "NEES" in one.name], section


def test_normalised_errors_are_checked_by_the_band_of_all_epochs_for_each_seed():
    """10 % overconfidence is 1.21 per degree of freedom: inside one epoch's 0.675 to 1.388, but not of 90.

    20 runs of 90 independent epochs are 5400 degrees of freedom, a band of 1 +- 1.96 sqrt(2 / 5400) = 0.038.
    """
    checks, section = nees_checks([drawn_campaign(seed) for seed in (11, 12, 14)])
    assert [one.passed for one in checks] == [True] * 8
    assert checks[0].at_most - checks[0].at_least == pytest.approx(2 * 0.038, rel=0.3)
    assert "outside" not in str(section.tables[0].rows)
    checks, section = nees_checks(
        [drawn_campaign(11), drawn_campaign(12, overconfidence=1.1), drawn_campaign(14)]
    )
    assert [one.passed for one in checks] == [True, False, True, False] * 2
    low, high = drawn_campaign(12).band()
    assert low < checks[1].value < high
    assert [["outside" in cell for cell in row[1:]] for row in section.tables[0].rows] == [
        [False] * 5, [True] * 5, [False] * 5,
    ]  # fmt: skip


def test_pooled_campaign_contains_all_runs():
    campaigns = [drawn_campaign(seed, runs=5) for seed in range(3)]
    together = pooled(campaigns)
    assert together.nees["position"].shape == (15, 90)
    assert len(together.innovations["height"]) == 15
    assert together.overall("position")[0] == pytest.approx(
        np.mean([one.overall("position")[0] for one in campaigns])
    )


def test_unobservable_tilt_is_that_of_the_simulated_biases():
    """40000 drawn biases: their mean tilt, and the share of means of eight above the limit (2.5 %)."""
    rng = np.random.default_rng(15)
    model = PROFILES["consumer"].accel_m_s2.at_interval(0.004)
    axes = rng.standard_normal((40_000, 2, 2)) * (model.turn_on_std, model.drift_std)
    tilts_deg = np.degrees(np.linalg.norm(axes.sum(axis=2), axis=1) / 9.80665)
    assert unobservable_tilt_deg(10**12) == pytest.approx(tilts_deg.mean(), rel=0.01)
    beyond = np.mean(tilts_deg.reshape(-1, 8).mean(axis=1) > unobservable_tilt_deg(8))
    assert beyond == pytest.approx(0.025, abs=0.015)


def test_calm_hover_with_consumer_sensors_adds_no_unobservable_tilt():
    """Eight flights; with an EKF2_ABIAS_INIT of 0.2 their mean is over the limit."""
    hovers = [
        Hover(seed=seed, mean_n=0.0, gust_rms_n=0.0, sensors="consumer", measure_s=10.0) for seed in range(8)
    ]
    assert np.mean([fly_hover(hover).tilt_deg for hover in hovers]) < unobservable_tilt_deg(8)


def test_unknown_subject_is_a_one_line_error():
    result = CliRunner().invoke(validate_app, ["--only", "hover,nonsense"])
    assert result.exit_code == BAD_INPUT
    assert result.stderr.count("\n") <= 2
    assert "nonsense" in result.stderr


def test_script_prints_only_json():
    done = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--only", "allocation", "--json"],
        capture_output=True, text=True, check=False, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {one["met"] for one in json.loads(done.stdout)["checks"]} == {True}


def test_stop_watch_subtracts_nested_parts():
    """10 ms nested, 5 ms around it, in wall time: with tolerance for a busy machine, but never negative."""

    def busy(seconds):
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            pass

    watch = _StopWatch()
    inner = watch.around("inner", lambda: busy(0.010))

    def outer():
        inner()
        busy(0.005)

    start_ns = time.perf_counter_ns()
    watch.around("outer", outer)()
    whole_ns = time.perf_counter_ns() - start_ns
    assert watch.spent_ns["inner"] >= 10e6
    assert 5e6 <= watch.spent_ns["outer"] <= whole_ns - watch.spent_ns["inner"]


def test_parts_of_a_step_add_up():
    recording = record_flight(16.0)
    cost = measure(recording, streams=False, repeats=1)
    assert 0 < recording.armed_from < len(recording.stream)
    assert sum(cost.parts_us.values()) == pytest.approx(cost.step_us)
    assert {part for part, _, _ in _PARTS} < set(cost.parts_us)
    assert cost.parts_us["ULog"] == 0.0
    assert min(spent_us for part, spent_us in cost.parts_us.items() if part != "ULog") > 0.0
    assert 0.0 < cost.floor_us < 0.5 * cost.step_us
    with_streams = measure(recording, streams=True, repeats=1)
    assert with_streams.parts_us["streams"] > 2.0 * cost.parts_us["streams"]
    with_log = measure(recording, streams=False, repeats=1, ulog=True)
    assert with_log.parts_us["ULog"] > 0.0

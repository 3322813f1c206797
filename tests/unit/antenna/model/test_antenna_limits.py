"""Limits of the solvers in the validation: touching elements, faint power, near pairs."""

import math

import numpy as np
import pytest
from antenna_checks import PLAN, missed
from msgspec.structs import replace

from studies.antenna import agreement, limits, near, power
from studies.antenna.checks import worst

LAMBDA_M = 10.0
needs_nec2 = pytest.mark.nec2


@pytest.fixture
def _pynec():
    pytest.importorskip("PyNEC", reason="the optional extra coflight[nec2] is not installed")


def test_all_solvers_report_the_same_touching_elements():
    answers = {
        (solver, name): limits.solve_touching(solver, name)
        for name in limits.TOUCHING
        for solver in ("batch", "nec2", "nec2c")
    }
    expected = {name: (0, -1) if "ground" in name else (0, 1) for name in limits.TOUCHING}
    assert all(one is None or one.touching == expected[name] for (_, name), one in answers.items())
    results = {group: [None] * len(jobs) for group, jobs in limits.jobs(PLAN).items()}
    results["touching"] = [answers[job.args] for job in limits.jobs(PLAN)["touching"]]
    assert missed(limits.judge(PLAN, results)) == []
    if len([one for one in results["touching"] if one is not None]) > len(limits.TOUCHING):
        results["touching"][-1] = limits.LimitAnswer(max_gain_dbi=5.0, average_gain=1.0)
        first = results["touching"][0]
        results["touching"][0] = replace(first, touching=(0, 2))
        assert len(missed(limits.judge(PLAN, results))) >= 1


@needs_nec2
@pytest.mark.usefixtures("_pynec")
def test_power_and_segments_are_evaluated():
    """Nine segments cost what the average gain says; at a wavelength of 5 m nine are not enough."""
    asked = limits.jobs(PLAN)
    results = {group: [None] * len(jobs) for group, jobs in asked.items()}
    results["short"] = [job() for job in asked["short"][:2]] + [None] * 3
    results["near"] = [job() if job.args[1] in {0.5, 0.15} else None for job in asked["near"]]
    results["refined"][0] = limits.solve_refined(5.0, 9, 21, 2)
    results["long"] = [
        job() if (job.args[0].segments, job.args[0].wavelength_m) == (9, 5.0) else None
        for job in asked["long"]
    ]
    section = limits.judge(PLAN, results)
    assert missed(section) == []
    assert {"directivity" in one.name for one in section.checks} == {True, False}
    results["short"][0] = replace(results["short"][0], max_gain_dbi=13.25)
    results["near"] = [None if one is None else replace(one, average_gain=0.9) for one in results["near"]]
    results["long"] = [
        replace(one, max_gain_dbi=one.max_gain_dbi + 0.1) if one and job.args[0].backend == "batch" else one
        for one, job in zip(results["long"], asked["long"], strict=True)
    ]
    converged = [0.01] * 2
    results["refined"][0] = agreement.Compared(
        limits_db=(0.0, 0.0), maximum_db=converged, pattern_db=converged, directivity_db=converged,
        average_gain=converged, nec2_average_gain=converged, redrawn=0, touching=0, disagreeing=0,
    )  # fmt: skip
    names = " ".join(missed(limits.judge(PLAN, results)))
    assert all(word in names for word in ("directivity", "average gain", "same segments", "not converged"))


def test_resistance_falls_against_reactance_by_the_cube_of_the_wavelength():
    """A short dipole's resistance goes with (l / lambda)^2, its reactance is a capacitor's, with lambda.

    The next terms of both series are in (pi l / lambda)^2, 2.5e-4 at 10 m.
    """
    ratios = [power.solve(wavelength_m, 9, 1).resistance_of_reactance for wavelength_m in (10.0, 20.0)]
    assert ratios[0] / ratios[1] == pytest.approx(8.0, rel=1e-3)


@needs_nec2
@pytest.mark.usefixtures("_pynec")
def test_wrong_power_of_nec2_does_not_affect_directivity():
    results = [power.solve(*size, 4) if size[1] == 9 else None for size in power.SIZES]
    checks, table = power.judge(results)
    assert missed(checks) == []
    assert len(table.rows) == sum(len(one.programs) + 1 for one in results if one)
    at = power.SIZES.index(power.FAINTEST)
    nec2 = results[at].programs["nec2"]
    # four formations: the power scatters by some percent, and the directivity by nothing of that
    assert np.std(nec2.average_gain) > 30.0 * abs(10.0 ** (worst(nec2.directivity_db) / 10.0) - 1.0)

    def judged(batch=results[at].batch, **fields):
        programs = {"nec2": replace(nec2, **fields)}
        changed = replace(results[at], programs=programs, batch=batch)
        return missed(power.judge([*results[:at], changed])[0])

    assert judged() == []
    assert "directivity" in " ".join(judged(directivity_db=(0.0, -1.01 * power.DIRECTIVITY_DB)))
    assert "not certain" in " ".join(judged(maximum_db=(0.009, -0.009)))
    unsteady = replace(results[at].batch, average_gain=(0.9959, 0.9959 + 1.01 * power.STEADY))
    assert "average gain" in " ".join(judged(batch=unsteady))


@needs_nec2
@pytest.mark.usefixtures("_pynec")
def test_pairs_have_the_requested_distance_and_solvers_agree_on_rejections():
    """At 0.1 m some of 10 formations have no credible power; all solvers refuse the same ones."""
    snapshots = near.pairs(0.1, 10)
    for one in snapshots:
        assert np.linalg.norm(one.centres_m[near.MOVED] - one.centres_m[near.BESIDE]) == pytest.approx(0.1)
    results = {group: [None] * len(jobs) for group, jobs in limits.jobs(PLAN).items()}
    results["pairs"][near.APART_M.index(0.1)] = found = near.solve_pairs(0.1, 10)
    checks, (table,) = near.judge(results)
    assert missed(checks) == []
    assert len(table.rows) == len(found.others)
    batch = found.others["batch"]
    assert 0 < batch.touching < 10
    assert batch.touching + len(batch.maximum_db) == 10
    for worse, word in (
        ({"maximum_db": (0.0, 0.011)}, "maximum"), ({"directivity_db": (0.0, 0.011)}, "directivity"),
        ({"pattern_db": (-0.11,)}, "pattern"), ({"disagreeing": 1}, "alone"),
    ):  # fmt: skip
        changed = near.Pairs(others={"batch": replace(batch, **worse)})
        names = missed(near.judge(results | {"pairs": [changed] + [None] * (len(near.APART_M) - 1)})[0])
        assert len(names) == 1
        assert word in names[0]


def test_zero_power_has_no_directivity():
    assert math.isnan(limits.LimitAnswer(max_gain_dbi=3.0, average_gain=-0.1).directivity_dbi)
    assert math.isnan(limits.LimitAnswer(refusal="elements 0 and 1 touch").directivity_dbi)

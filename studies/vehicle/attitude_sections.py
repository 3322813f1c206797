"""Upset recovery and control allocation against their requirements."""

from functools import partial

import numpy as np

from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.vehicle import upsets
from studies.vehicle.allocation import AllocationResult, check_allocation
from studies.vehicle.figures import save_upsets
from studies.vehicle.plan import VehiclePlan
from studies.vehicle.solo import STEP_S

ROUNDING_N_M = 1e-9
_ALLOCATION_SEED = 1


def upset_jobs(plan: VehiclePlan) -> dict[str, list[Job]]:
    """Return the recoveries of the controller and the upsets of the complete vehicle."""
    return {
        "recover": [partial(upsets.recover, seed) for seed in range(plan.recoveries)],
        "throw": [partial(upsets.throw, seed) for seed in range(plan.throws)],
    }


def judge_upsets(plan: VehiclePlan, results: Results) -> Section:
    """Check the slowest recoveries."""
    recoveries: list[upsets.Upset] = results["recover"]
    catches: list[upsets.Catch] = results["throw"]
    checks = (
        Check(
            "controller: upright, slowest", max(case.upright_s for case in recoveries), "s",
            at_most=upsets.LIMIT_S,
        ),
        Check(
            "whole vehicle: thrust axis aligned with its setpoint, slowest",
            max(case.aligned_s for case in catches), "s", at_most=upsets.LIMIT_S,
        ),
        Check(
            f"whole vehicle: tilt below {upsets.TILT_LIMIT_DEG + upsets.UPRIGHT_DEG:.0f}°, slowest",
            max(case.within_limit_s for case in catches), "s", at_most=upsets.LIMIT_S,
        ),
        Check(
            "whole vehicle: distance from its position at the end, worst",
            max(case.away_m for case in catches), "m", at_most=0.5,
        ),
    )  # fmt: skip
    columns: list[tuple[str, list[float]]] = [
        ("controller: rate at the start, rad/s", [case.start_rate_rad_s for case in recoveries]),
        ("controller: tilt at the start, deg", [case.tilt_deg[0] for case in recoveries]),
        ("controller: upright after, s", [case.upright_s for case in recoveries]),
        ("vehicle: tilt at release, deg", [case.start_tilt_deg for case in catches]),
        ("vehicle: rate at release, rad/s", [case.start_rate_rad_s for case in catches]),
        ("vehicle: aligned after, s", [case.aligned_s for case in catches]),
        ("vehicle: height lost, m", [case.sunk_m for case in catches]),
        ("vehicle: attitude estimate's greatest error, deg", [case.attitude_error_deg for case in catches]),
    ]
    draw = partial(
        save_upsets, period_s=upsets.TRACE_EVERY * STEP_S, limit_s=upsets.LIMIT_S,
        upright_deg=upsets.UPRIGHT_DEG, tilts_deg=np.array([case.tilt_deg for case in recoveries]),
    )  # fmt: skip
    return Section(
        title="Upsets",
        conditions=(
            f"Controller: {plan.recoveries} starts at 30 m in random attitudes, first those that are upside "
            f"down, with rates of up to {upsets.RATE_MAX_RAD_S:g} rad/s. The plant is a 6-DOF Iris with the "
            "inertial sensors' noise, and level flight is commanded. The vehicle is upright when its tilt "
            f"stays below {upsets.UPRIGHT_DEG:g} degrees. Whole vehicle: {plan.throws} upsets with the "
            "estimator in the loop, from position hold at 30 m: for 0.15 to 0.9 s a second controller flies "
            "its motors towards a random attitude and then releases them. Position hold tilts the vehicle "
            f"to brake the speed gained, so here the thrust axis must stay within {upsets.ALIGNED_DEG:g} "
            f"degrees of the position controller's setpoint, and {upsets.CATCH_S:g} s later the vehicle must "
            f"be back at its position. The {upsets.ALIGNED_DEG:g} degrees are a choice of this study: the "
            "setpoint moves during braking, and an alignment within 10 degrees takes up to 2.3 s.\n"
        ),
        checks=checks,
        tables=(
            ReportTable(
                caption="Distribution:",
                columns=("what", "median", "95 %", "greatest"),
                rows=tuple(
                    (name, *(f"{value:.3g}" for value in np.quantile(values, (0.5, 0.95, 1.0))))
                    for name, values in columns
                ),
            ),
        ),
        figures=(
            ReportFigure("validation-upsets.png", "tilt over time from random attitudes and rates", draw),
        ),
    )


def allocation_jobs(plan: VehiclePlan) -> dict[str, list[Job]]:
    """Return one job, which takes some seconds."""
    return {"all": [partial(check_allocation, plan.demands, _ALLOCATION_SEED)]}


def judge_allocation(plan: VehiclePlan, results: Results) -> Section:  # noqa: ARG001  # common signature
    """Check the worst of all demands."""
    worst: AllocationResult = results["all"][0]
    return Section(
        title="Allocation",
        conditions=(
            f"{worst.demands} random demands of thrust 0 to 1 and torque up to twice full scale, with and "
            "without airmode, evaluated with the motors' thrust curve. The roll and pitch torques of "
            f"{worst.achievable} demands with airmode are achievable. Torques that are not achievable must "
            "keep their direction.\n"
        ),
        checks=(
            Check("lowest control", worst.lowest_control, at_least=0.0),
            Check("highest control", worst.highest_control, at_most=1.0),
            Check(
                "achievable roll and pitch torque that was not produced", worst.lost_torque_n_m, "N m",
                at_most=ROUNDING_N_M,
            ),
            Check(
                "direction of torque that is not achievable", worst.turned_rad, "rad", at_most=ROUNDING_N_M
            ),
            Check(
                "torque produced against torque reported", worst.misreported_n_m, "N m", at_most=ROUNDING_N_M
            ),
            Check("thrust added for torque without airmode", worst.added_thrust, at_most=1e-12),
        ),
    )  # fmt: skip

"""Step responses of position and velocity against their requirements."""

from functools import partial

import numpy as np

from autopilot.control import ControlParams
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.vehicle.figures import save_steps
from studies.vehicle.moves import (
    TRACE_S,
    MoveResponse,
    allowed_s,
    band_of,
    fly_move,
    fly_velocity_step,
    minimum_time_s,
    respond,
)
from studies.vehicle.plan import VehiclePlan

DISTANCES_M = (1.0, 5.0, 20.0)
VELOCITIES = (
    ("2 m/s north", (2.0, 0.0, 0.0)),
    ("5 m/s north", (5.0, 0.0, 0.0)),
    ("2 m/s up", (0.0, 0.0, -2.0)),
    ("1 m/s down", (0.0, 0.0, 1.0)),
)
OVERSHOOT = 0.05
VELOCITY_OVERSHOOT = 0.10


def jobs(plan: VehiclePlan) -> dict[str, list[Job]]:
    """Return the jobs of each step on every seed; the mean over the seeds suppresses the noise."""
    seeds = range(plan.seeds)
    groups: dict[str, list[Job]] = {
        f"{distance_m:g} m": [partial(fly_move, seed, distance_m) for seed in seeds]
        for distance_m in DISTANCES_M
    }
    for name, vel_ned_m_s in VELOCITIES:
        groups[name] = [partial(fly_velocity_step, seed, vel_ned_m_s) for seed in seeds]
    return groups


def judge(plan: VehiclePlan, results: Results) -> Section:
    """Check overshoot and settling time."""
    limits = ControlParams().trajectory
    checks, rows = [], []
    moves: list[tuple[str, MoveResponse, float]] = []
    for distance_m in DISTANCES_M:
        name = f"{distance_m:g} m"
        response = respond(results[name], band=band_of(distance_m))
        moves.append((name, response, allowed_s(distance_m, limits)))
        checks += [
            _overshoot_check(name, response, OVERSHOOT),
            Check(f"{name}: settled", response.settled_s, "s", at_most=moves[-1][2]),
        ]
        rows.append((
            name, f"{minimum_time_s(distance_m, limits):.2f} s", f"{response.settled_s:.2f} s",
            *_overshoot_cells(response),
        ))  # fmt: skip
    velocities: list[tuple[str, MoveResponse]] = []
    for name, _ in VELOCITIES:
        response = respond(results[name], band=0.05)
        velocities.append((name, response))
        checks.append(_overshoot_check(name, response, VELOCITY_OVERSHOOT))
        rows.append((name, "", "", *_overshoot_cells(response)))
    draw = partial(
        save_steps,
        period_s=TRACE_S,
        moves=[(name, np.array(response.trace), limit_s) for name, response, limit_s in moves],
        velocities=[(name, np.array(response.trace)) for name, response in velocities],
    )
    return Section(
        title="Steps",
        conditions=(
            "The complete vehicle with the estimator and Gazebo's sensors (GPS 5 Hz, 0.12 s late) in the "
            "loop, in calm air at 10 m, observer on. A companion computer streams the jerk-limited reference "
            "of a move as offboard setpoints at 50 Hz; velocity steps are streamed without shaping. The "
            f"response is the mean of {plan.seeds} flights with different noise and random courses. It is "
            "settled when it stays within 5 % of the step or 0.1 m, whichever is larger. The limit is 1.15 "
            "times the minimum time at the limits of speed, acceleration and jerk, plus 1 s.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="The overshoot of the worst single flight includes its noise in hover:",
                columns=("step", "minimum time", "settled", "overshoot", "of the worst flight"),
                rows=tuple(rows),
            ),
        ),
        figures=(ReportFigure("validation-steps.png", "responses to steps of position and velocity", draw),),
    )


def _overshoot_check(name: str, response: MoveResponse, limit: float) -> Check:
    return Check(f"{name}: overshoot", 100.0 * response.overshoot, "%", at_most=100.0 * limit)


def _overshoot_cells(response: MoveResponse) -> tuple[str, str]:
    return f"{100.0 * response.overshoot:.1f} %", f"{100.0 * response.worst_overshoot:.1f} %"

"""Steps of position and velocity against their requirements."""

from pathlib import Path

import numpy as np

from autopilot.control import ControlParams
from studies.common.report import Check, ReportTable, Section
from studies.vehicle.figures import save_steps
from studies.vehicle.moves import (
    TRACE_S,
    Move,
    MoveResponse,
    VelocityStep,
    allowed_s,
    band_of,
    fly_move,
    fly_velocity_step,
    minimum_time_s,
    respond,
)
from studies.vehicle.plan import Job, Results, VehiclePlan

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
    """Each step on every seed: the mean is to be of the response, not of the noise."""
    seeds = range(plan.seeds)
    groups: dict[str, list[Job]] = {
        f"{distance_m:g} m": [(fly_move, Move(seed=seed, distance_m=distance_m)) for seed in seeds]
        for distance_m in DISTANCES_M
    }
    for name, vel_ned_m_s in VELOCITIES:
        groups[name] = [
            (fly_velocity_step, VelocityStep(seed=seed, vel_ned_m_s=vel_ned_m_s)) for seed in seeds
        ]
    return groups


def judge(plan: VehiclePlan, results: Results, images: Path | None) -> Section:
    """Check overshoot and the time until it is settled."""
    limits = ControlParams().trajectory
    checks, rows = [], []
    moves: list[tuple[str, MoveResponse, float]] = []
    for distance_m in DISTANCES_M:
        name = f"{distance_m:g} m"
        response = respond(results[name], band=band_of(distance_m))
        moves.append((name, response, allowed_s(distance_m, limits)))
        checks += [
            Check(
                name=f"{name}: overshoot",
                value=100.0 * response.overshoot,
                unit="%",
                at_most=100.0 * OVERSHOOT,
            ),
            Check(name=f"{name}: settled", value=response.settled_s, unit="s", at_most=moves[-1][2]),
        ]
        rows.append((
            name, f"{minimum_time_s(distance_m, limits):.2f} s", f"{response.settled_s:.2f} s",
            f"{100.0 * response.overshoot:.1f} %", f"{100.0 * response.worst_overshoot:.1f} %",
        ))  # fmt: skip
    velocities: list[tuple[str, MoveResponse]] = []
    for name, _ in VELOCITIES:
        response = respond(results[name], band=0.05)
        velocities.append((name, response))
        checks.append(
            Check(
                name=f"{name}: overshoot",
                value=100.0 * response.overshoot,
                unit="%",
                at_most=100.0 * VELOCITY_OVERSHOOT,
            )
        )
        rows.append((
            name, "", "", f"{100.0 * response.overshoot:.1f} %", f"{100.0 * response.worst_overshoot:.1f} %",
        ))  # fmt: skip
    figures: tuple[tuple[str, str], ...] = ()
    if images is not None:
        save_steps(
            images / "validation-steps.png",
            period_s=TRACE_S,
            moves=[(name, np.array(response.trace), limit_s) for name, response, limit_s in moves],
            velocities=[(name, np.array(response.trace)) for name, response in velocities],
        )
        figures = (("validation-steps.png", "responses to steps of position and velocity"),)
    return Section(
        title="Steps",
        conditions=(
            "The whole vehicle, estimator and Gazebo's sensors (GPS 5 Hz, 0.12 s late) in the loop, in "
            "calm air at 10 m, observer on. A companion streams the jerk-limited reference of a move as "
            "offboard setpoints at 50 Hz; velocities are streamed bare. The response is the mean of "
            f"{plan.seeds} flights with different noise, on random courses. Settled is what "
            "stays within 5 % of the step or 0.1 m, whichever is more; allowed are 1.15 times the minimum "
            "time at the limits of speed, acceleration and jerk, and a second.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="The worst single flight has the noise of its hover in it:",
                columns=("step", "minimum time", "settled", "overshoot", "of the worst flight"),
                rows=tuple(rows),
            ),
        ),
        figures=figures,
    )

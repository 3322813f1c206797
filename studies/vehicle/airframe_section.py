"""Hover, steps and motor failures of each packaged airframe."""

from functools import partial

from msgspec.structs import replace

from autopilot.control.airframe_gains import allocation_params
from autopilot.control.mixing import mixer_without
from foundation.airframe.files import load, names
from studies.common.report import Check, ReportTable, Section
from studies.common.runner import Job, Results
from studies.vehicle.hover import Hover, HoverResult, fly_hover
from studies.vehicle.moves import MoveResponse, band_of, fly_move, fly_velocity_step, respond
from studies.vehicle.plan import VehiclePlan

HOVER_LIMIT_M = 0.10
"""Twice the calm rms of the Iris with these sensors."""
FAILURE_LIMIT_M = 0.5
DISTANCE_M = 5.0
OVERSHOOT = 0.05
SPEED_M_S = 2.0
VELOCITY_OVERSHOOT = 0.15


def _seeds(plan: VehiclePlan) -> range:
    return range(max(plan.seeds // 2, 1))


def _hover(plan: VehiclePlan, airframe: str, seed: int) -> Hover:
    """Return a hover in calm air with Gazebo's sensors."""
    return Hover(
        seed=seed, mean_n=0.0, gust_rms_n=0.0, sensors="gazebo", measure_s=plan.measure_s, airframe=airframe
    )


def _redundant() -> tuple[str, ...]:
    """Return the airframes that fly on without motor 0."""
    return tuple(name for name in names() if mixer_without(allocation_params(load(name)), {0}) is not None)


def jobs(plan: VehiclePlan) -> dict[str, list[Job]]:
    """Return the jobs of each airframe: hover, position step, velocity step, hover without one motor."""
    seeds = _seeds(plan)
    groups: dict[str, list[Job]] = {}
    for name in names():
        groups[f"{name}: hover"] = [partial(fly_hover, _hover(plan, name, seed)) for seed in seeds]
        groups[f"{name}: move"] = [partial(fly_move, seed, DISTANCE_M, name) for seed in seeds]
        groups[f"{name}: velocity"] = [
            partial(fly_velocity_step, seed, (SPEED_M_S, 0.0, 0.0), name) for seed in seeds
        ]
    for name in _redundant():
        rotors = len(load(name).rotors)
        groups[f"{name}: failure"] = [
            partial(fly_hover, replace(_hover(plan, name, seed), stopped_motor=seed % rotors))
            for seed in seeds
        ]
    return groups


def judge(plan: VehiclePlan, results: Results) -> Section:
    """Check the hover of all, and the hover of those that fly on without a motor."""
    checks, rows = [], []
    redundant = _redundant()
    for name in names():
        airframe = load(name)
        hover_m = _mean_m(results[f"{name}: hover"])
        move = respond(results[f"{name}: move"], band=band_of(DISTANCE_M))
        velocity = respond(results[f"{name}: velocity"], band=0.05)
        checks += [
            Check(f"{name}: calm hover, 3-D rms", hover_m, "m", at_most=HOVER_LIMIT_M),
            _overshoot(f"{name}: {DISTANCE_M:g} m", move, OVERSHOOT),
            _overshoot(f"{name}: {SPEED_M_S:g} m/s", velocity, VELOCITY_OVERSHOOT),
        ]
        without = ""
        if name in redundant:
            failures: list[HoverResult] = results[f"{name}: failure"]
            without_m = _mean_m(failures)
            worst_m = max(flight.total_m for flight in failures)
            without = f"{without_m:.3f} m (worst {worst_m:.3f})"
            checks.append(
                Check(f"{name}: one motor stops, worst 3-D rms", worst_m, "m", at_most=FAILURE_LIMIT_M)
            )
        rows.append((
            name, f"{airframe.mass_kg:g} kg", str(len(airframe.rotors)), f"{airframe.hover_share:.2f}",
            f"{hover_m:.3f} m", f"{move.settled_s:.2f} s", f"{100.0 * move.overshoot:.1f} %",
            f"{100.0 * velocity.overshoot:.1f} %", without,
        ))  # fmt: skip
    return Section(
        title="Airframes",
        conditions=(
            "Each packaged airframe with the gains that follow from its file "
            "([Airframes](../how-to/airframes.md)), Gazebo's sensors (GPS 5 Hz, 0.12 s late), calm air, "
            f"observer on: offboard hold at 5 m for {plan.measure_s:g} s, a move of {DISTANCE_M:g} m along "
            f"the jerk-limited reference, and an unshaped velocity step of {SPEED_M_S:g} m/s north, as in "
            f"the section above. {len(_seeds(plan))} flights each. Where the rotors that are left can hover, "
            "one motor stops at the beginning of the measurement, a different one in each flight; the rms "
            "includes the transient, and yaw is given up if need be.\n"
        ),
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="Thrust in hover is the share of the range between idle and full thrust:",
                columns=(
                    "airframe", "mass", "rotors", "thrust in hover", "hover, 3-D rms",
                    f"{DISTANCE_M:g} m settled", "overshoot", f"{SPEED_M_S:g} m/s overshoot",
                    "without one motor, 3-D rms",
                ),
                rows=tuple(rows),
            ),
        ),
    )  # fmt: skip


def _mean_m(flights: list[HoverResult]) -> float:
    return sum(flight.total_m for flight in flights) / len(flights)


def _overshoot(name: str, response: MoveResponse, limit: float) -> Check:
    return Check(f"{name}: overshoot", 100.0 * response.overshoot, "%", at_most=100.0 * limit)

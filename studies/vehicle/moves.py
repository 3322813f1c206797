"""Step responses of the complete vehicle: jerk-limited position steps, unshaped velocity steps.

The setpoints are streamed in offboard mode, as by a companion computer. Sensor noise moves a hovering vehicle
by some centimetres, so the response is the mean of several flights that differ in noise and course only. The
worst single flight is reported as well.
"""

import math

import numpy as np
from msgspec import Struct

from autopilot.control import ControlParams
from autopilot.control.params import TrajectoryParams
from autopilot.navigation.guide import Guide
from autopilot.parameters.config import Vector
from foundation.airframe.files import DEFAULT, load
from foundation.types import Array
from studies.vehicle.hover import SENSORS
from studies.vehicle.solo import STEP_S, Solo, solo_config

HEIGHT_M = 10.0
LEAD_S = 2.0
"""Hover before the step, which is the origin of the trace."""
TRACE_EVERY = 5
"""Steps between the samples of a trace: 50 Hz."""
TRACE_S = STEP_S * TRACE_EVERY
BAND_M = 0.1
BAND_FRACTION = 0.05
"""Settled: within 5 % of the step or 0.1 m, whichever is larger."""
_SETTLE_S = 5.0


class MoveResponse(Struct, frozen=True, kw_only=True):
    """Mean response to a step over several flights."""

    overshoot: float
    """Of the mean response, as a fraction of the step; 0 if none"""
    worst_overshoot: float
    """Of the worst single flight, noise included"""
    settled_s: float
    """Settling time of the mean response"""
    trace: tuple[float, ...]
    """Mean response along the step, every `TRACE_S`, starting at the step"""


def minimum_time_s(distance_m: float, limits: TrajectoryParams) -> float:
    """Return the minimum time of a horizontal move, rest to rest, limited in jerk J, acceleration A, speed V.

    Jerk limit only: four phases of (d / 2 J)^(1/3). With A reached: twice A/2J + sqrt((A/2J)^2 + d/A). With V
    reached as well: d/V + V/A + A/J; without A, d/V + 2 sqrt(V/J).
    """
    speed, acc, jerk = limits.xy_cruise_m_s, limits.acc_xy_m_s2, limits.jerk_m_s3
    to_speed_s = speed / acc + acc / jerk if speed > acc * acc / jerk else 2.0 * math.sqrt(speed / jerk)
    if distance_m >= speed * to_speed_s:
        return distance_m / speed + to_speed_s
    if distance_m >= 2.0 * acc**3 / jerk**2:
        half_s = acc / (2.0 * jerk)
        return 2.0 * (half_s + math.sqrt(half_s * half_s + distance_m / acc))
    return 4.0 * float(np.cbrt(distance_m / (2.0 * jerk)))


def allowed_s(distance_m: float, limits: TrajectoryParams | None = None) -> float:
    """Return the limit of a move's settling time: 1.15 times the minimum time plus 1 s."""
    return 1.15 * minimum_time_s(distance_m, limits or ControlParams().trajectory) + 1.0


def fly_move(seed: int, distance_m: float, airframe: str = DEFAULT) -> Array:
    """Fly a position step; return the distance over the commanded distance, (T,), every `TRACE_S`."""
    limits = ControlParams().trajectory
    course_rad = float(np.random.default_rng([seed, 3]).uniform(-math.pi, math.pi))
    along = np.array((math.cos(course_rad), math.sin(course_rad), 0.0))
    hover = np.array((0.0, 0.0, -HEIGHT_M))
    with _hovering(seed, airframe) as solo:
        solo.set_position(*hover.tolist())
        solo.offboard()
        solo.run(_SETTLE_S + LEAD_S)
        start_s = solo.now_s
        reference = Guide(limits)
        reference.reset(hover, vel_ned_m_s=np.zeros(3), yaw_rad=0.0)
        reference.go_to(hover + distance_m * along)
        for _ in range(round((allowed_s(distance_m, limits) + 5.0) / TRACE_S)):
            solo.set_reference(reference.update(TRACE_S))
            solo.run(TRACE_S)
        track = solo.track.after(start_s)
    return np.asarray((track.pos_ned_m[::TRACE_EVERY] - hover) @ along / distance_m)


def fly_velocity_step(seed: int, vel_ned_m_s: Vector, airframe: str = DEFAULT) -> Array:
    """Fly an unshaped velocity step from rest; return 8 s of speed over command, (T,), every `TRACE_S`."""
    commanded = np.array(vel_ned_m_s)
    speed_m_s = float(np.linalg.norm(commanded))
    with _hovering(seed, airframe) as solo:
        solo.set_velocity(0.0, 0.0, 0.0)
        solo.offboard()
        solo.run(_SETTLE_S + LEAD_S)
        start_s = solo.now_s
        solo.set_velocity(*vel_ned_m_s)
        solo.run(8.0)
        track = solo.track.after(start_s)
    return np.asarray(track.vel_ned_m_s[::TRACE_EVERY] @ commanded / speed_m_s**2)


def respond(traces: list[Array], *, band: float) -> MoveResponse:
    """Return the mean response of the flights; ``band`` is the settling band, a fraction of the step."""
    all_traces = np.array(traces)
    mean = all_traces.mean(axis=0)
    outside = np.flatnonzero(np.abs(mean - 1.0) > band)
    return MoveResponse(
        overshoot=max(float(mean.max()) - 1.0, 0.0),
        worst_overshoot=max(float(all_traces.max()) - 1.0, 0.0),
        settled_s=TRACE_S * (int(outside[-1]) + 1 if outside.size else 0),
        trace=tuple(mean.tolist()),
    )


def band_of(distance_m: float) -> float:
    """Return the settling band of a move as a fraction of its distance."""
    return max(BAND_FRACTION, BAND_M / distance_m)


def _hovering(seed: int, airframe: str) -> Solo:
    """Return a vehicle that has taken off to 10 m in calm air, with Gazebo's sensors."""
    sensors = SENSORS["gazebo"]
    config = solo_config(seed=seed, gps_delay_s=sensors.gps_model().delay_s, airframe=load(airframe))
    solo = Solo(config, sensors=sensors, seed=np.random.SeedSequence([seed, 2]))
    solo.take_off(HEIGHT_M)
    return solo

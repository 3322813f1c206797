"""Upset recovery: return to level from any attitude and rate, upside down included.

Two tests. (1) The controller by itself over the independent 6-DOF body of `rigid_body` starts in random
attitudes; its estimate is the truth with inertial noise. (2) The complete vehicle with its estimator in the
loop is upset in flight: a second controller takes over its motors, flies it towards a random attitude and
then releases them.
"""

import math

import numpy as np
from msgspec import Struct

from autopilot.control import ControlParams, FlightController
from foundation.geometry.rotations import quat_rotate
from foundation.types import Array, AttitudeSetpoint, EstimatorState
from studies.vehicle.hover import SENSORS
from studies.vehicle.rigid_body import DT_S, Iris, estimate
from studies.vehicle.solo import STEP_S, FlightError, Solo, solo_config

HEIGHT_M = 30.0
UPRIGHT_DEG = 10.0
"""Largest tilt that counts as upright"""
LIMIT_S = 1.5
RATE_MAX_RAD_S = 4.0
WATCH_S = 2.4
ALIGNED_DEG = 15.0
TILT_LIMIT_DEG = math.degrees(ControlParams().position.tilt_max_rad)
CATCH_S = 12.0
TRACE_EVERY = 5
LEVEL = AttitudeSetpoint(q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), yaw_rate_rad_s=0.0, thrust=0.53)
"""Level at hover thrust"""
_NO_FORCE = np.zeros(3)
_HALF_TURNS = ((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 1.0))
"""Flown first, because they are critical for quaternions: upside down, nose down."""
_THROW_S = (0.15, 0.9)
_THROW_THRUST = 0.2
_SETTLE_S = 2.0
_BODY_UP = np.array((0.0, 0.0, -1.0))


class Upset(Struct, frozen=True, kw_only=True):
    """Recovery of the controller by itself."""

    start_rate_rad_s: float
    upright_s: float
    """Time from which the tilt stays within `UPRIGHT_DEG`, until `WATCH_S`"""
    tilt_deg: tuple[float, ...]
    """Every `TRACE_EVERY` steps, from the start"""


class Catch(Struct, frozen=True, kw_only=True):
    """Recovery of the complete vehicle from one upset.

    Position hold tilts the vehicle up to its tilt limit to brake the speed gained in the upset. The criterion
    is therefore the angle between the thrust axis and the position controller's setpoint, which moves while
    the vehicle brakes.
    """

    start_tilt_deg: float
    start_rate_rad_s: float
    aligned_s: float
    """Time from which the thrust axis stays within `ALIGNED_DEG` of its setpoint, until `CATCH_S`"""
    within_limit_s: float
    """Time from which the tilt stays below the tilt limit plus `UPRIGHT_DEG`"""
    sunk_m: float
    """Largest height loss below the held position"""
    away_m: float
    """Distance from the held position at the end"""
    attitude_error_deg: float
    """Largest error of the estimate"""


def recover(seed: int) -> Upset:
    """Recover from a random attitude with rates of up to 4 rad/s: level flight is commanded."""
    rng = np.random.default_rng([seed, 5])
    q = np.array(_HALF_TURNS[seed]) if seed < len(_HALF_TURNS) else rng.standard_normal(4)
    rates = rng.standard_normal(3)
    rates *= RATE_MAX_RAD_S * rng.random() ** (1.0 / 3.0) / np.linalg.norm(rates)
    body = Iris(
        height_m=HEIGHT_M, q_ned_frd=q / np.linalg.norm(q), omega_frd_rad_s=rates.copy(), noise_seed=seed
    )
    controller = FlightController(ControlParams())
    tilts_deg = [_tilt_deg(body.q_ned_frd)]
    for _ in range(round(WATCH_S / DT_S)):
        controls = controller.update(body.estimate(), LEVEL, dt_s=DT_S, landed=False)
        body.step(np.array(controls), _NO_FORCE)
        tilts_deg.append(_tilt_deg(body.q_ned_frd))
    return Upset(
        start_rate_rad_s=float(np.linalg.norm(rates)),
        upright_s=_last_above(tilts_deg, UPRIGHT_DEG),
        tilt_deg=tuple(tilts_deg[::TRACE_EVERY]),
    )


def throw(seed: int) -> Catch:
    """Upset the complete vehicle while it holds its position at 30 m, and record its recovery."""
    rng = np.random.default_rng([seed, 6])
    sensors = SENSORS["gazebo"]
    config = solo_config(seed=seed, gps_delay_s=sensors.gps_model().delay_s)
    with Solo(config, sensors=sensors, seed=np.random.SeedSequence([seed, 7])) as solo:
        solo.take_off(HEIGHT_M)
        solo.set_position(0.0, 0.0, -HEIGHT_M)
        solo.offboard()
        solo.run(_SETTLE_S)
        q = rng.standard_normal(4)
        upset = AttitudeSetpoint(q_ned_frd=q / np.linalg.norm(q), yaw_rate_rad_s=0.0, thrust=_THROW_THRUST)
        thrower = FlightController(ControlParams())
        for _ in range(round(rng.uniform(*_THROW_S) / STEP_S)):
            controls = thrower.update(_true_state(solo), upset, dt_s=STEP_S, landed=False)
            solo.step(controls=np.array(controls))
        start_s, truth = solo.now_s, solo.world.truth
        off_deg, tilts_deg = [], [_tilt_deg(truth.q_ned_frd[0])]
        for _ in range(round(CATCH_S / STEP_S)):
            solo.step()
            q_now, setpoint = solo.world.truth.q_ned_frd[0], solo.vehicle.flight.attitude_setpoint()
            if setpoint is None:
                raise FlightError("the vehicle was disarmed in the air after an upset")
            off_deg.append(_angle_deg(_up_ned(q_now), _up_ned(setpoint.q_ned_frd)))
            tilts_deg.append(_tilt_deg(q_now))
        track = solo.track.after(start_s)
    return Catch(
        start_tilt_deg=tilts_deg[0],
        start_rate_rad_s=float(np.linalg.norm(truth.omega_frd_rad_s[0])),
        aligned_s=_last_above(off_deg, ALIGNED_DEG),
        within_limit_s=_last_above(tilts_deg, TILT_LIMIT_DEG + UPRIGHT_DEG),
        sunk_m=HEIGHT_M + float(track.pos_ned_m[:, 2].max()),
        away_m=float(np.linalg.norm(track.pos_ned_m[-1] - (0.0, 0.0, -HEIGHT_M))),
        attitude_error_deg=math.degrees(float(track.attitude_error_rad.max())),
    )


def _last_above(angles_deg: list[float], limit_deg: float) -> float:
    """Return the time in seconds from which all angles, one each step, stay within the limit."""
    above = [k for k, angle_deg in enumerate(angles_deg) if angle_deg > limit_deg]
    return STEP_S * (above[-1] + 1 if above else 0)


def _true_state(solo: Solo) -> EstimatorState:
    """Return the truth as an estimate, for the controller that causes the upset."""
    truth = solo.world.truth
    return estimate(
        pos_ned_m=truth.pos_ned_m[0], vel_ned_m_s=truth.vel_ned_m_s[0], q_ned_frd=truth.q_ned_frd[0],
        omega_frd_rad_s=truth.omega_frd_rad_s[0], acc_ned_m_s2=truth.acc_ned_m_s2[0],
    )  # fmt: skip


def _up_ned(q_ned_frd: Array) -> Array:
    """Return the body's -z axis in NED, (3,)."""
    up: Array = quat_rotate(q_ned_frd, _BODY_UP)
    return up


def _tilt_deg(q_ned_frd: Array) -> float:
    return _angle_deg(_up_ned(q_ned_frd), _BODY_UP)


def _angle_deg(first: Array, second: Array) -> float:
    """Return the angle between unit vectors."""
    return math.degrees(math.acos(min(max(float(first @ second), -1.0), 1.0)))

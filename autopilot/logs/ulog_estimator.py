"""ULog samples of the estimator's status, innovations and states, by field; None before its alignment.

Other aiding than GPS, barometer and magnetic heading does not exist here; its fields are NaN.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from autopilot.logs.ulog_messages import Values

if TYPE_CHECKING:
    from autopilot.estimation.aiding import Aiding
    from autopilot.estimation.fusion import Fusion
    from autopilot.vehicle.vehicle import Vehicle

_STATES, _VARIANCES = 25, 24
"""Of EKF2; ours are the first, in the same order."""
_COUNTER = 256
_FIX_3D = 3
# bits of estimator_status.control_mode_flags
_TILT_ALIGNED, _YAW_ALIGNED, _GNSS_POS, _MAG_HEADING, _IN_AIR, _BARO_HEIGHT = 0, 1, 2, 4, 7, 9
_MAG_DISTURBED, _MAG_FAULT = 16, 18
# bits of solution_status_flags, MAVLink's ESTIMATOR_STATUS_FLAGS
_ATTITUDE, _VELOCITY, _POSITION, _HEIGHT, _CONSTANT, _GLITCH, _ACCEL_ERROR = 1, 6, 24, 32, 128, 1024, 2048
# bits of gps_check_fail_flags
_NO_FIX, _FEW_SATELLITES, _INACCURATE = 1, 2, 8
_VEL_UNHEALTHY, _POS_UNHEALTHY, _HEIGHT_UNHEALTHY = 1, 2, 4


def status(vehicle: "Vehicle") -> Values | None:
    """Return estimator_status; test ratios are those of the innovation to its gate, not squared."""
    estimator, state = vehicle.estimator, vehicle.flight.state
    fusion, delayed = estimator.fusion, estimator.filter
    if fusion is None or delayed is None:
        return None
    north_std_m, east_std_m, down_std_m = state.pos_std_m.tolist()
    compass, kinds = fusion.compass, (fusion.velocity, fusion.position, fusion.height)
    glitch = max(fusion.velocity.test_ratio, fusion.position.test_ratio) >= 1.0
    modes = (
        (True, _TILT_ALIGNED), (True, _YAW_ALIGNED), (state.position_valid, _GNSS_POS),
        (not compass.faulty, _MAG_HEADING), (not vehicle.pilot.landed, _IN_AIR),
        (not fusion.barometer.stuck, _BARO_HEIGHT), (compass.disturbed, _MAG_DISTURBED),
        (compass.faulty, _MAG_FAULT),
    )  # fmt: skip
    solution = (
        (state.attitude_valid, _ATTITUDE), (state.velocity_valid, _VELOCITY),
        (state.position_valid, _POSITION), (state.height_valid, _HEIGHT),
        (fusion.held_pos_m is not None, _CONSTANT), (glitch, _GLITCH), (fusion.vertical.bad, _ACCEL_ERROR),
    )  # fmt: skip
    rejected = [kind.test_ratio >= 1.0 for kind in kinds]
    bits = (_VEL_UNHEALTHY, _POS_UNHEALTHY, _HEIGHT_UNHEALTHY)
    timed_out = (not state.velocity_valid, not state.position_valid, not state.height_valid)
    return {
        "timestamp_sample": delayed.horizon_us, "gps_check_fail_flags": _gps_faults(vehicle),
        "output_tracking_error": (0.0, 0.0, 0.0),
        "control_mode_flags": sum(1 << bit for holds, bit in modes if holds),
        "solution_status_flags": sum(bit for holds, bit in solution if holds),
        "pos_horiz_accuracy": math.hypot(north_std_m, east_std_m), "pos_vert_accuracy": down_std_m,
        "hdg_test_ratio": _finite(fusion.heading.test_ratio), "vel_test_ratio": _finite(kinds[0].test_ratio),
        "pos_test_ratio": _finite(kinds[1].test_ratio), "hgt_test_ratio": _finite(kinds[2].test_ratio),
        "reset_count_vel_ne": state.vel_reset_counter % _COUNTER,
        "reset_count_vel_d": state.vel_reset_counter % _COUNTER,
        "reset_count_pos_ne": state.pos_reset_counter % _COUNTER,
        "reset_count_pod_d": state.height_reset_counter % _COUNTER,
        "reset_count_quat": state.yaw_reset_counter % _COUNTER, "time_slip": 0.0,
        "pre_flt_fail_mag_field_disturbed": compass.disturbed,
        "health_flags": sum(bit for holds, bit in zip(rejected, bits, strict=True) if holds),
        "timeout_flags": sum(bit for holds, bit in zip(timed_out, bits, strict=True) if holds),
    }  # fmt: skip


def innovations(vehicle: "Vehicle") -> Values | None:
    """Return estimator_innovations of the last measurement of each kind, accepted or not."""
    fusion, delayed = vehicle.estimator.fusion, vehicle.estimator.filter
    if fusion is None or delayed is None:
        return None
    found = (fusion.velocity, fusion.position, fusion.height, fusion.heading)
    return _by_field(delayed.horizon_us, [kind.innovation.tolist() for kind in found])


def variances(vehicle: "Vehicle") -> Values | None:
    """Return estimator_innovation_variances of the same."""
    fusion, delayed = vehicle.estimator.fusion, vehicle.estimator.filter
    if fusion is None or delayed is None:
        return None
    found = (fusion.velocity, fusion.position, fusion.height, fusion.heading)
    return _by_field(delayed.horizon_us, [kind.innovation_var.tolist() for kind in found])


def test_ratios(vehicle: "Vehicle") -> Values | None:
    """Return estimator_innovation_test_ratios: squares of the innovations over those of their gates."""
    fusion, delayed = vehicle.estimator.fusion, vehicle.estimator.filter
    if fusion is None or delayed is None:
        return None
    return _by_field(delayed.horizon_us, [_ratios(kind, gate) for kind, gate in _gates(vehicle, fusion)])


def states(vehicle: "Vehicle") -> Values | None:
    """Return estimator_states at the delayed horizon: attitude, velocity, position, both biases."""
    delayed = vehicle.estimator.filter
    if delayed is None:
        return None
    values, variances = delayed.x.tolist(), np.diagonal(delayed.cov).tolist()
    return {
        "timestamp_sample": delayed.horizon_us, "n_states": len(values),
        "states": values + [0.0] * (_STATES - len(values)),
        "covariances": variances + [0.0] * (_VARIANCES - len(variances)),
    }  # fmt: skip


def sensor_bias(vehicle: "Vehicle") -> Values | None:
    """Return estimator_sensor_bias; there is no estimate of a magnetometer's bias."""
    delayed, params = vehicle.estimator.filter, vehicle.estimator.params
    if delayed is None:
        return None
    state, variances = vehicle.flight.state, np.diagonal(delayed.cov).tolist()
    return {
        "timestamp_sample": delayed.horizon_us,
        "gyro_bias": state.gyro_bias_rad_s.tolist(), "gyro_bias_limit": params.gyro_bias_limit_rad_s,
        "gyro_bias_variance": variances[9:12], "gyro_bias_valid": True,
        "accel_bias": state.accel_bias_m_s2.tolist(), "accel_bias_limit": params.accel_bias_limit_m_s2,
        "accel_bias_variance": variances[12:15], "accel_bias_valid": True,
    }  # fmt: skip


def _by_field(horizon_us: int, found: list[list[float]]) -> Values:
    """Return the fields from those of velocity (3,), position (2,), height and heading."""
    velocity, position, height, heading = found
    return {
        "timestamp_sample": horizon_us, "gps_hvel": velocity[:2], "gps_vvel": velocity[2],
        "gps_hpos": position, "baro_vpos": height[0], "heading": heading[0],
    }  # fmt: skip


def _gates(vehicle: "Vehicle", fusion: "Fusion") -> list[tuple["Aiding", float]]:
    params = vehicle.estimator.params
    return [
        (fusion.velocity, params.gps_vel_gate),
        (fusion.position, params.gps_pos_gate),
        (fusion.height, params.baro_gate),
        (fusion.heading, params.heading_gate),
    ]


def _ratios(kind: "Aiding", gate: float) -> list[float]:
    pairs = zip(kind.innovation.tolist(), kind.innovation_var.tolist(), strict=True)
    return [value * value / (gate * gate * var) if var > 0.0 else math.nan for value, var in pairs]


def _gps_faults(vehicle: "Vehicle") -> int:
    """Return the bits of the checks of a fix that fail."""
    fix, params = vehicle.flight.gps, vehicle.estimator.params
    if fix is None:
        return _NO_FIX
    checks = (
        (fix.fix_type < _FIX_3D, _NO_FIX),
        (fix.satellites_visible < params.gps_required_satellites, _FEW_SATELLITES),
        (fix.eph * 1e-2 > params.gps_required_eph_m, _INACCURATE),
    )
    return sum(bit for fails, bit in checks if fails)


def _finite(ratio: float) -> float:
    return ratio if math.isfinite(ratio) else math.nan

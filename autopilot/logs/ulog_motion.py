"""ULog samples of estimate, setpoints and outputs of one vehicle, by field; None: there is none."""

import math
from typing import TYPE_CHECKING

from autopilot.logs.ulog_messages import Values
from autopilot.navigation.site_frame import geodetic
from foundation.geometry.rotations import quat_to_euler

if TYPE_CHECKING:
    from autopilot.vehicle.vehicle import Vehicle

_NAN3 = (math.nan, math.nan, math.nan)
_MOTORS, _OUTPUTS = 12, 16
"""Capacities of actuator_motors and actuator_outputs."""
_DISARMED_PWM_US, _LEAST_PWM_US, _PWM_RANGE_US = 900.0, 1000.0, 1000.0
"""PX4's PWM_SIM_DISARM, and the pulse widths of the outputs of its SITL."""
_COUNTER = 256
"""Reset counters are bytes."""


def local_position(vehicle: "Vehicle", known_us: int) -> Values | None:
    """Return vehicle_local_position; ``known_us``: when the origin became known, 0 before."""
    flight = vehicle.flight
    state, known = flight.state, flight.origin_known
    if not state.attitude_valid:
        return None
    pos_m, vel_m_s, acc_m_s2 = (
        state.pos_ned_m.tolist(),
        state.vel_ned_m_s.tolist(),
        state.acc_ned_m_s2.tolist(),
    )
    north_std_m, east_std_m, down_std_m = state.pos_std_m.tolist()
    north_std_m_s, east_std_m_s, down_std_m_s = state.vel_std_m_s.tolist()
    roll_std, pitch_std, yaw_std = state.attitude_std_rad.tolist()
    pos_reset_m, vel_reset_m_s = state.pos_reset_delta_ned_m.tolist(), state.vel_reset_delta_ned_m_s.tolist()
    return {
        "timestamp_sample": flight.clock.estimate_us,
        "xy_valid": state.position_valid, "z_valid": state.height_valid,
        "v_xy_valid": state.velocity_valid, "v_z_valid": state.velocity_valid,
        "x": pos_m[0], "y": pos_m[1], "z": pos_m[2],
        "delta_xy": pos_reset_m[:2], "xy_reset_counter": state.pos_reset_counter % _COUNTER,
        "delta_z": pos_reset_m[2], "z_reset_counter": state.height_reset_counter % _COUNTER,
        "vx": vel_m_s[0], "vy": vel_m_s[1], "vz": vel_m_s[2], "z_deriv": vel_m_s[2],
        "delta_vxy": vel_reset_m_s[:2], "vxy_reset_counter": state.vel_reset_counter % _COUNTER,
        "delta_vz": vel_reset_m_s[2], "vz_reset_counter": state.vel_reset_counter % _COUNTER,
        "ax": acc_m_s2[0], "ay": acc_m_s2[1], "az": acc_m_s2[2],
        "heading": quat_to_euler(state.q_ned_frd).tolist()[2], "heading_var": yaw_std * yaw_std,
        "delta_heading": state.yaw_reset_delta_rad,
        "heading_reset_counter": state.yaw_reset_counter % _COUNTER,
        "heading_good_for_control": True, "tilt_var": roll_std * roll_std + pitch_std * pitch_std,
        "xy_global": known, "z_global": known, "ref_timestamp": known_us,
        "ref_lat": state.origin_lat_deg if known else math.nan,
        "ref_lon": state.origin_lon_deg if known else math.nan,
        "ref_alt": state.origin_alt_m if known else math.nan,
        "eph": math.hypot(north_std_m, east_std_m), "epv": down_std_m,
        "evh": math.hypot(north_std_m_s, east_std_m_s), "evv": down_std_m_s,
        "dead_reckoning": state.navigation_failed,
        "vxy_max": math.inf, "vz_max": math.inf, "hagl_min": math.inf, "hagl_max_z": math.inf,
        "hagl_max_xy": math.inf,
    }  # fmt: skip


def global_position(vehicle: "Vehicle") -> Values | None:
    """Return vehicle_global_position; the simulation has no geoid, so both altitudes are equal."""
    flight = vehicle.flight
    state = flight.state
    if not (flight.origin_known and state.position_valid):
        return None
    lat_deg, lon_deg, alt_m = geodetic(state.pos_ned_m, state)
    north_std_m, east_std_m, down_std_m = state.pos_std_m.tolist()
    return {
        "timestamp_sample": flight.clock.estimate_us, "lat": lat_deg, "lon": lon_deg, "alt": alt_m,
        "alt_ellipsoid": alt_m, "lat_lon_valid": True, "alt_valid": state.height_valid,
        "lat_lon_reset_counter": state.pos_reset_counter % _COUNTER,
        "alt_reset_counter": state.height_reset_counter % _COUNTER,
        "eph": math.hypot(north_std_m, east_std_m), "epv": down_std_m,
        "dead_reckoning": state.navigation_failed,
    }  # fmt: skip


def attitude_setpoint(vehicle: "Vehicle") -> Values | None:
    """Return vehicle_attitude_setpoint."""
    setpoint = vehicle.flight.attitude_setpoint()
    if setpoint is None:
        return None
    return {
        "q_d": setpoint.q_ned_frd.tolist(),
        "yaw_sp_move_rate": setpoint.yaw_rate_rad_s,
        "thrust_body": (0.0, 0.0, -setpoint.thrust),
    }


def local_position_setpoint(vehicle: "Vehicle") -> Values | None:
    """Return vehicle_local_position_setpoint: inputs and results of the position controller."""
    if vehicle.flight.setpoint is None:
        return None
    block = vehicle.pilot.controller.block
    position = block["position"]
    output, asked = position["output"], position["setpoint"]
    used = asked["pos_axes"][0].tolist()
    pos_m = [
        value if axis else math.nan for value, axis in zip(asked["pos_ned_m"][0].tolist(), used, strict=True)
    ]
    vel_m_s = output["vel_ned_m_s"][0].tolist()
    return {
        "x": pos_m[0], "y": pos_m[1], "z": pos_m[2], "vx": vel_m_s[0], "vy": vel_m_s[1], "vz": vel_m_s[2],
        "acceleration": output["acc_ned_m_s2"][0].tolist(), "thrust": output["thrust_ned"][0].tolist(),
        "yaw": block["yaw_rad"].item(), "yawspeed": block["yaw_rate_rad_s"].item(),
    }  # fmt: skip


def trajectory_setpoint(vehicle: "Vehicle") -> Values | None:
    """Return trajectory_setpoint: what the mode or the application demands."""
    setpoint = vehicle.flight.setpoint
    if setpoint is None:
        return None

    def axes(vector: object, used: tuple[bool, bool, bool]) -> tuple[float, ...]:
        if vector is None:
            return _NAN3
        return tuple(value if axis else math.nan for value, axis in zip(vector, used, strict=True))  # type: ignore[call-overload]

    return {
        "position": axes(setpoint.pos_ned_m, setpoint.pos_axes),
        "velocity": axes(setpoint.vel_ned_m_s, setpoint.vel_axes),
        "acceleration": axes(setpoint.acc_ned_m_s2, setpoint.acc_axes),
        "yaw": math.nan if setpoint.yaw_rad is None else setpoint.yaw_rad,
        "yawspeed": setpoint.yaw_rate_rad_s,
    }


def motors(vehicle: "Vehicle") -> Values:
    """Return actuator_motors: 0..1, NaN while disarmed and for motors that the vehicle does not have."""
    controls = list(vehicle.flight.motors()) if vehicle.commander.armed else []
    return {"timestamp_sample": vehicle.flight.now_us, "control": controls[:_MOTORS]}


def outputs(vehicle: "Vehicle") -> Values:
    """Return actuator_outputs: pulse widths in us as those of PX4's SITL."""
    controls = vehicle.flight.motors()[:_OUTPUTS]
    armed = vehicle.commander.armed
    widths_us = [_LEAST_PWM_US + _PWM_RANGE_US * each if armed else _DISARMED_PWM_US for each in controls]
    return {"noutputs": len(widths_us), "output": widths_us + [0.0] * (_OUTPUTS - len(widths_us))}


def hover_thrust(vehicle: "Vehicle") -> Values:
    """Return hover_thrust_estimate."""
    flight, controller = vehicle.flight, vehicle.pilot.controller
    return {
        "timestamp_sample": flight.clock.estimate_us,
        "hover_thrust": controller.hover_thrust,
        "valid": vehicle.commander.armed and not vehicle.pilot.landed,
    }


def rate_integrals(vehicle: "Vehicle") -> Values:
    """Return rate_ctrl_status."""
    roll, pitch, yaw = vehicle.pilot.controller.block["rates"]["integral"][0].tolist()
    return {"rollspeed_integ": roll, "pitchspeed_integ": pitch, "yawspeed_integ": yaw}


def home(vehicle: "Vehicle", count: int) -> Values | None:
    """Return home_position, which was set for the ``count``-th time."""
    place = vehicle.flight.home
    if place is None:
        return None
    north_m, east_m, down_m = place.pos_ned_m
    w, x, y, z = place.q_ned_frd
    yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return {
        "lat": place.lat_deg, "lon": place.lon_deg, "alt": place.alt_m, "x": north_m, "y": east_m,
        "z": down_m, "yaw": yaw_rad, "valid_alt": True, "valid_hpos": True, "valid_lpos": True,
        "update_count": count,
    }  # fmt: skip

"""Settings of the flight controller.

Each docstring begins with the corresponding PX4 parameter; defaults are PX4's for the Iris. Angles are
radians where PX4 uses degrees. Thrust is a fraction of full thrust *above idle* (see
`autopilot.control.allocation`).
"""

from math import radians
from typing import Annotated

from msgspec import Meta, Struct

from foundation.airframe.description import Rotor
from foundation.airframe.files import IRIS

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Tilt = Annotated[float, Meta(gt=0.0, le=radians(89.0))]


class PositionParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Position P and velocity PID controllers; the output is an acceleration."""

    xy_p: NonNegative = 0.95
    """MPC_XY_P: horizontal position gain, 1/s"""
    z_p: NonNegative = 1.0
    """MPC_Z_P: vertical position gain, 1/s"""
    xy_vel_p_acc: Positive = 1.8
    """MPC_XY_VEL_P_ACC: horizontal velocity P gain, 1/s"""
    xy_vel_i_acc: NonNegative = 0.4
    """MPC_XY_VEL_I_ACC: horizontal velocity I gain, 1/s^2"""
    xy_vel_d_acc: NonNegative = 0.2
    """MPC_XY_VEL_D_ACC: horizontal velocity D gain"""
    z_vel_p_acc: Positive = 4.0
    """MPC_Z_VEL_P_ACC: vertical velocity P gain, 1/s"""
    z_vel_i_acc: NonNegative = 2.0
    """MPC_Z_VEL_I_ACC: vertical velocity I gain, 1/s^2"""
    z_vel_d_acc: NonNegative = 0.0
    """MPC_Z_VEL_D_ACC: vertical velocity D gain"""
    acc_cutoff_hz: Positive = 5.0
    """MPC_VELD_LP: cutoff of the low-pass filter of the acceleration in the D terms"""
    xy_vel_max_m_s: Positive = 12.0
    """MPC_XY_VEL_MAX: greatest horizontal speed setpoint"""
    z_vel_max_up_m_s: Positive = 3.0
    """MPC_Z_VEL_MAX_UP: greatest climb rate setpoint"""
    z_vel_max_dn_m_s: Positive = 1.5
    """MPC_Z_VEL_MAX_DN: greatest descent rate setpoint"""
    tilt_max_rad: Tilt = radians(45.0)
    """MPC_TILTMAX_AIR: greatest tilt of position control"""
    thr_hover: Annotated[float, Meta(ge=0.1, le=0.8)] = 0.5
    """MPC_THR_HOVER: initial value of the hover thrust estimate"""
    thr_min: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.12
    """MPC_THR_MIN: least thrust, which keeps the direction of the thrust vector defined"""
    thr_max: Annotated[float, Meta(ge=0.1, le=1.0)] = 1.0
    """MPC_THR_MAX: greatest thrust"""
    thr_xy_margin: Fraction = 0.3
    """MPC_THR_XY_MARG: horizontal thrust reserved from vertical control"""
    tko_ramp_s: Positive = 3.0
    """MPC_TKO_RAMP_T: duration of the take-off ramp"""
    tko_speed_m_s: Positive = 1.5
    """MPC_TKO_SPEED: climb limit at the end of the take-off ramp"""


class DisturbanceParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Disturbance observer of the position loop. PX4 has no equivalent, so the names are coflight's."""

    enabled: bool = True
    """CF_DOB_EN: 1 enables the disturbance observer"""
    cutoff_hz: Annotated[float, Meta(gt=0.0, le=20.0)] = 2.0
    """CF_DOB_CUTOFF: cutoff of the low-pass filter of the estimate"""
    thrust_lag_s: NonNegative = 0.02
    """Time constant of the motors: the observer models the lag of the thrust with it"""
    acc_max_m_s2: Positive = 8.0
    """CF_DOB_ACC_MAX: greatest magnitude of the estimate; 5 N on an Iris is 3.2 m/s^2"""
    integral_share: Fraction = 0.5
    """CF_DOB_I_SHARE: scale of the velocity integral gains while the observer is enabled: the observer does
    part of their work, and it cancels the drag that damps them. Overshoot of a 2 m/s velocity step on the
    Iris: 6 % at 0.5, 11 % at 1"""


class HoverThrustParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Kalman filter of the hover thrust."""

    process_noise_1_s: Positive = 0.0036
    """HTE_HT_NOISE: process noise"""
    initial_std: Positive = 0.1
    """HTE_HT_ERR_INIT: initial standard deviation"""
    gate_sigma: Positive = 3.0
    """HTE_ACC_GATE: innovation gate, standard deviations"""
    range: Annotated[float, Meta(ge=0.05, le=0.4)] = 0.2
    """HTE_THR_RANGE: greatest deviation of the estimate from thr_hover"""


class AttitudeParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Attitude P controller; the output is body rates."""

    roll_p: NonNegative = 6.5
    """MC_ROLL_P: roll gain, 1/s"""
    pitch_p: NonNegative = 6.5
    """MC_PITCH_P: pitch gain, 1/s"""
    yaw_p: NonNegative = 2.8
    """MC_YAW_P: yaw gain, 1/s"""
    yaw_weight: Fraction = 0.4
    """MC_YAW_WEIGHT: priority of yaw relative to tilt"""
    roll_rate_max_rad_s: Positive = radians(220.0)
    """MC_ROLLRATE_MAX: greatest roll rate setpoint"""
    pitch_rate_max_rad_s: Positive = radians(220.0)
    """MC_PITCHRATE_MAX: greatest pitch rate setpoint"""
    yaw_rate_max_rad_s: Positive = radians(200.0)
    """MC_YAWRATE_MAX: greatest yaw rate setpoint"""


class RateParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rate PID controller; the output is normalised torque."""

    roll_k: Positive = 1.34
    """MC_ROLLRATE_K: roll loop gain. PX4's 1.0 applies to a motor command whose thrust slope at hover is 1.34
    times the mean slope (dT/du 9.42 N, mean 7.01 N). Here the allocation makes thrust linear, so 1.34 gives
    the same loop gain."""
    pitch_k: Positive = 1.34
    """MC_PITCHRATE_K: pitch loop gain"""
    yaw_k: Positive = 1.34
    """MC_YAWRATE_K: yaw loop gain"""
    roll_p: NonNegative = 0.15
    """MC_ROLLRATE_P: roll rate P gain, s/rad"""
    pitch_p: NonNegative = 0.15
    """MC_PITCHRATE_P: pitch rate P gain, s/rad"""
    yaw_p: NonNegative = 0.2
    """MC_YAWRATE_P: yaw rate P gain, s/rad"""
    roll_i: NonNegative = 0.2
    """MC_ROLLRATE_I: roll rate I gain, 1/rad"""
    pitch_i: NonNegative = 0.2
    """MC_PITCHRATE_I: pitch rate I gain, 1/rad"""
    yaw_i: NonNegative = 0.1
    """MC_YAWRATE_I: yaw rate I gain, 1/rad"""
    roll_d: NonNegative = 0.003
    """MC_ROLLRATE_D: roll rate D gain, s^2/rad"""
    pitch_d: NonNegative = 0.003
    """MC_PITCHRATE_D: pitch rate D gain, s^2/rad"""
    yaw_d: NonNegative = 0.0
    """MC_YAWRATE_D: yaw rate D gain, s^2/rad"""
    roll_ff: NonNegative = 0.0
    """MC_ROLLRATE_FF: roll rate feed-forward gain, s/rad"""
    pitch_ff: NonNegative = 0.0
    """MC_PITCHRATE_FF: pitch rate feed-forward gain, s/rad"""
    yaw_ff: NonNegative = 0.0
    """MC_YAWRATE_FF: yaw rate feed-forward gain, s/rad"""
    integral_max: NonNegative = 0.3
    """MC_RR_INT_LIM, MC_PR_INT_LIM, MC_YR_INT_LIM: limit of the integral, in normalised torque"""
    derivative_cutoff_hz: Positive = 30.0
    """IMU_DGYRO_CUTOFF: cutoff of the low-pass filter of the D term"""


class AllocationParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rotors and thrust model."""

    rotors: tuple[Rotor, ...] = IRIS.rotors
    """CA_ROTORi_PX, _PY, _PZ, _AX, _AY, _AZ: in the order of the motor controls"""
    moment_m: float = IRIS.propulsion.moment_m
    """CA_ROTORi_KM, without the sign: torque about the axis of a rotor per thrust"""
    thrust_model_factor: Fraction = IRIS.propulsion.thrust_model_factor
    """THR_MDL_FAC: factor of the quadratic term in thrust = factor u^2 + (1 - factor) u.
    A rotor at w = 1000 u + 100 rad/s with thrust k w^2 has, relative to idle and as a fraction of full
    thrust, exactly (w^2 - 100^2) / (1100^2 - 100^2) = 5/6 u^2 + 1/6 u."""
    hover_share: Fraction = IRIS.hover_share
    """Share of the thrust range that carries the airframe with all rotors"""
    yaw_thrust_margin: Fraction = 0.15
    """Greatest reduction of collective thrust that keeps yaw authority at full thrust (PX4: fixed)"""
    failure_mode: Annotated[int, Meta(ge=0, le=1)] = 1
    """CA_FAILURE_MODE: 1: failed motors are removed from the allocation if the others can hover, without yaw
    control if need be; 0: failures are ignored (PX4: 0)"""


class TrajectoryParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of position trajectories."""

    xy_cruise_m_s: Positive = 5.0
    """MPC_XY_CRUISE: horizontal speed of automatic modes"""
    z_vel_up_m_s: Positive = 3.0
    """MPC_Z_V_AUTO_UP: climb rate of automatic modes"""
    z_vel_dn_m_s: Positive = 1.5
    """MPC_Z_V_AUTO_DN: descent rate of automatic modes"""
    acc_xy_m_s2: Positive = 3.0
    """MPC_ACC_HOR: greatest horizontal acceleration"""
    acc_up_m_s2: Positive = 4.0
    """MPC_ACC_UP_MAX: greatest upward acceleration"""
    acc_dn_m_s2: Positive = 3.0
    """MPC_ACC_DOWN_MAX: greatest downward acceleration"""
    jerk_m_s3: Positive = 4.0
    """MPC_JERK_AUTO: greatest jerk of automatic modes"""
    acc_lead_s: NonNegative = 0.1
    """Lead of the acceleration feed-forward, which compensates the lag of attitude loop and motors. Tuned on
    the Iris: overshoot of moves of 1 and 5 m is 2.0 and 1.7 %, without lead 7.7 and 4.2 %"""
    xy_error_max_m: Positive = 2.0
    """MPC_XY_ERR_MAX: horizontal distance to the vehicle at which the position setpoint stops"""
    yaw_rate_max_rad_s: Positive = radians(45.0)
    """MPC_YAWRAUTO_MAX: greatest yaw rate of automatic modes"""
    yaw_acc_max_rad_s2: Positive = radians(60.0)
    """MPC_YAWRAUTO_ACC: greatest yaw acceleration of automatic modes (PX4: 20 deg/s^2)"""


class ControlParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of `FlightController` and of the references that it follows."""

    position: PositionParams = PositionParams()
    disturbance: DisturbanceParams = DisturbanceParams()
    hover_thrust: HoverThrustParams = HoverThrustParams()
    attitude: AttitudeParams = AttitudeParams()
    rate: RateParams = RateParams()
    allocation: AllocationParams = AllocationParams()
    trajectory: TrajectoryParams = TrajectoryParams()
    position_divider: Annotated[int, Meta(ge=1, le=8)] = 2
    """The position loop runs at every n-th update: at 125 Hz of 250 Hz"""

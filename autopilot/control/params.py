"""Settings of the flight controller.

Each docstring names the PX4 parameter that a field stands for; defaults are PX4's for the Iris. Angles are
radians here where PX4 has degrees. Thrust is a fraction of full thrust *above idle* (see
`autopilot.control.allocation`).
"""

from math import radians
from typing import Annotated

from msgspec import Meta, Struct

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Tilt = Annotated[float, Meta(gt=0.0, le=radians(89.0))]
Vector = tuple[float, float, float]


class PositionParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Position P and velocity PID; their output is an acceleration."""

    xy_p: NonNegative = 0.95
    """MPC_XY_P, 1/s"""
    z_p: NonNegative = 1.0
    """MPC_Z_P, 1/s"""
    xy_vel_p_acc: Positive = 1.8
    """MPC_XY_VEL_P_ACC, 1/s"""
    xy_vel_i_acc: NonNegative = 0.4
    """MPC_XY_VEL_I_ACC, 1/s^2"""
    xy_vel_d_acc: NonNegative = 0.2
    """MPC_XY_VEL_D_ACC"""
    z_vel_p_acc: Positive = 4.0
    """MPC_Z_VEL_P_ACC, 1/s"""
    z_vel_i_acc: NonNegative = 2.0
    """MPC_Z_VEL_I_ACC, 1/s^2"""
    z_vel_d_acc: NonNegative = 0.0
    """MPC_Z_VEL_D_ACC"""
    acc_cutoff_hz: Positive = 5.0
    """MPC_VELD_LP: low-pass of the acceleration that the D terms act on"""
    xy_vel_max_m_s: Positive = 12.0
    """MPC_XY_VEL_MAX"""
    z_vel_max_up_m_s: Positive = 3.0
    """MPC_Z_VEL_MAX_UP"""
    z_vel_max_dn_m_s: Positive = 1.5
    """MPC_Z_VEL_MAX_DN"""
    tilt_max_rad: Tilt = radians(45.0)
    """MPC_TILTMAX_AIR"""
    thr_hover: Annotated[float, Meta(ge=0.1, le=0.8)] = 0.5
    """MPC_THR_HOVER: where the hover thrust estimate starts"""
    thr_min: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.12
    """MPC_THR_MIN: keeps the thrust vector defined"""
    thr_max: Annotated[float, Meta(ge=0.1, le=1.0)] = 1.0
    """MPC_THR_MAX"""
    thr_xy_margin: Fraction = 0.3
    """MPC_THR_XY_MARG: horizontal thrust that vertical control leaves alone"""
    tko_ramp_s: Positive = 3.0
    """MPC_TKO_RAMP_T"""
    tko_speed_m_s: Positive = 1.5
    """MPC_TKO_SPEED: climb limit at the end of the take-off ramp"""


class DisturbanceParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Disturbance observer of the position loop. PX4 has no counterpart, so the names are coflight's."""

    enabled: bool = True
    """CF_DOB_EN"""
    cutoff_hz: Annotated[float, Meta(gt=0.0, le=20.0)] = 2.0
    """CF_DOB_CUTOFF: low-pass of the estimate"""
    thrust_lag_s: NonNegative = 0.02
    """Time constant of the motors: thrust that is ordered but not yet there is no disturbance"""
    acc_max_m_s2: Positive = 8.0
    """CF_DOB_ACC_MAX: largest estimate, as a vector; 5 N on an Iris is 3.2 m/s^2"""
    integral_share: Fraction = 0.5
    """CF_DOB_I_SHARE: of the velocity integral gains, while the observer is on: it takes over what they are
    for, and it takes away the drag that damped them. Overshoot of a 2 m/s velocity step on the Iris: 6 %
    against 11 % at 1"""


class HoverThrustParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Kalman filter of the hover thrust."""

    process_noise_1_s: Positive = 0.0036
    """HTE_HT_NOISE"""
    initial_std: Positive = 0.1
    """HTE_HT_ERR_INIT"""
    gate_sigma: Positive = 3.0
    """HTE_ACC_GATE"""
    range: Annotated[float, Meta(ge=0.05, le=0.4)] = 0.2
    """HTE_THR_RANGE: the estimate stays this near to thr_hover"""


class AttitudeParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Attitude P; its output is body rates."""

    roll_p: NonNegative = 6.5
    """MC_ROLL_P, 1/s"""
    pitch_p: NonNegative = 6.5
    """MC_PITCH_P, 1/s"""
    yaw_p: NonNegative = 2.8
    """MC_YAW_P, 1/s"""
    yaw_weight: Fraction = 0.4
    """MC_YAW_WEIGHT: priority of yaw against tilt"""
    roll_rate_max_rad_s: Positive = radians(220.0)
    """MC_ROLLRATE_MAX"""
    pitch_rate_max_rad_s: Positive = radians(220.0)
    """MC_PITCHRATE_MAX"""
    yaw_rate_max_rad_s: Positive = radians(200.0)
    """MC_YAWRATE_MAX"""


class RateParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rate PID; its output is normalised torque."""

    roll_k: Positive = 1.34
    """MC_ROLLRATE_K. PX4's 1.0 acts on a motor command whose thrust rises 1.34 times its mean slope at hover
    (dT/du = 9.42 N of 7.01 N); the allocation here makes thrust linear, so this keeps PX4's loop gain."""
    pitch_k: Positive = 1.34
    """MC_PITCHRATE_K"""
    yaw_k: Positive = 1.34
    """MC_YAWRATE_K"""
    roll_p: NonNegative = 0.15
    """MC_ROLLRATE_P, s/rad"""
    pitch_p: NonNegative = 0.15
    """MC_PITCHRATE_P, s/rad"""
    yaw_p: NonNegative = 0.2
    """MC_YAWRATE_P, s/rad"""
    roll_i: NonNegative = 0.2
    """MC_ROLLRATE_I, 1/rad"""
    pitch_i: NonNegative = 0.2
    """MC_PITCHRATE_I, 1/rad"""
    yaw_i: NonNegative = 0.1
    """MC_YAWRATE_I, 1/rad"""
    roll_d: NonNegative = 0.003
    """MC_ROLLRATE_D, s^2/rad"""
    pitch_d: NonNegative = 0.003
    """MC_PITCHRATE_D, s^2/rad"""
    yaw_d: NonNegative = 0.0
    """MC_YAWRATE_D, s^2/rad"""
    roll_ff: NonNegative = 0.0
    """MC_ROLLRATE_FF, s/rad"""
    pitch_ff: NonNegative = 0.0
    """MC_PITCHRATE_FF, s/rad"""
    yaw_ff: NonNegative = 0.0
    """MC_YAWRATE_FF, s/rad"""
    integral_max: NonNegative = 0.3
    """MC_RR_INT_LIM, MC_PR_INT_LIM, MC_YR_INT_LIM: of normalised torque"""
    derivative_cutoff_hz: Positive = 30.0
    """IMU_DGYRO_CUTOFF"""


class Rotor(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One rotor that thrusts along -z of the body."""

    pos_frd_m: Vector
    """CA_ROTORi_PX, _PY, _PZ, from the centre of mass"""
    torque_ratio_m: float
    """CA_ROTORi_KM: yaw torque per thrust, positive for a rotor turning counter-clockwise from above"""


IRIS_ROTORS = (
    Rotor(pos_frd_m=(0.13, 0.22, -0.023), torque_ratio_m=0.06),
    Rotor(pos_frd_m=(-0.13, -0.20, -0.023), torque_ratio_m=0.06),
    Rotor(pos_frd_m=(0.13, -0.22, -0.023), torque_ratio_m=-0.06),
    Rotor(pos_frd_m=(-0.13, 0.20, -0.023), torque_ratio_m=-0.06),
)
"""Front right, back left, front left, back right."""


class AllocationParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The airframe: where the rotors are and how their thrust follows the command."""

    rotors: tuple[Rotor, Rotor, Rotor, Rotor] = IRIS_ROTORS
    """CA_ROTORi_*, in the order of the motor controls"""
    thrust_model_factor: Fraction = 5.0 / 6.0
    """THR_MDL_FAC: share of the quadratic part in thrust = factor u^2 + (1 - factor) u.
    A rotor at w = 1000 u + 100 rad/s with thrust k w^2 gives, above its idle thrust and as a fraction of
    full, exactly (w^2 - 100^2) / (1100^2 - 100^2) = 5/6 u^2 + 1/6 u."""
    yaw_thrust_margin: Fraction = 0.15
    """Collective thrust given up at most for yaw to keep some authority at full thrust (PX4: fixed)"""


class TrajectoryParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Shape of position moves."""

    xy_cruise_m_s: Positive = 5.0
    """MPC_XY_CRUISE"""
    z_vel_up_m_s: Positive = 3.0
    """MPC_Z_V_AUTO_UP"""
    z_vel_dn_m_s: Positive = 1.5
    """MPC_Z_V_AUTO_DN"""
    acc_xy_m_s2: Positive = 3.0
    """MPC_ACC_HOR"""
    acc_up_m_s2: Positive = 4.0
    """MPC_ACC_UP_MAX"""
    acc_dn_m_s2: Positive = 3.0
    """MPC_ACC_DOWN_MAX"""
    jerk_m_s3: Positive = 4.0
    """MPC_JERK_AUTO"""
    acc_lead_s: NonNegative = 0.1
    """Time by which the acceleration feed-forward leads, against the lag of attitude loop and motors.
    Chosen on the Iris: overshoot of moves of 1 and 5 m is 2.0 and 1.7 %, without lead 7.7 and 4.2 %"""
    xy_error_max_m: Positive = 2.0
    """MPC_XY_ERR_MAX: a setpoint this far ahead of the vehicle waits for it"""
    yaw_rate_max_rad_s: Positive = radians(45.0)
    """MPC_YAWRAUTO_MAX"""
    yaw_acc_max_rad_s2: Positive = radians(60.0)
    """MPC_YAWRAUTO_ACC (PX4: 20 deg/s^2)"""


class ControlParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that `FlightController` and `PositionTrajectory` are told."""

    position: PositionParams = PositionParams()
    disturbance: DisturbanceParams = DisturbanceParams()
    hover_thrust: HoverThrustParams = HoverThrustParams()
    attitude: AttitudeParams = AttitudeParams()
    rate: RateParams = RateParams()
    allocation: AllocationParams = AllocationParams()
    trajectory: TrajectoryParams = TrajectoryParams()
    position_divider: Annotated[int, Meta(ge=1, le=8)] = 2
    """The position loop runs at every n-th update: 125 Hz of 250 Hz"""

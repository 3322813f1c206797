"""The vehicle's parameters: PX4's names, units and ranges, and the corresponding settings.

The settings structs of estimation, control, navigation and commander hold the values in SI; PX4's names and
units are defined in this table alone. Defaults are those of the structs. The parameters without effect of
`autopilot.parameters.inert` are added to it.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from operator import attrgetter
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from msgspec import Struct, structs

from autopilot.commander.battery import BatteryParams, BatterySimParams
from autopilot.commander.failure_detector import FailureDetectorParams
from autopilot.commander.geofence import GeofenceParams
from autopilot.commander.land_detector import LandDetectorParams
from autopilot.commander.params import CommanderParams
from autopilot.control.params import ControlParams
from autopilot.estimation.params import EstimatorParams
from autopilot.estimation.sensor_input import SensorsParams
from autopilot.navigation.params import NavigationParams
from autopilot.parameters.inert import STATED, STATED_OF, Stated


class ParameterProblem(IntEnum):
    """Cause of a ParameterError, as in MAV_PARAM_ERROR."""

    UNKNOWN = 1
    VALUE = 2
    """Out of range, or inconsistent with another parameter."""
    READ_ONLY = 5
    TYPE = 7


class ParameterError(ValueError):
    """A parameter that cannot be read or set; the text is one line."""

    def __init__(self, text: str, problem: ParameterProblem = ParameterProblem.VALUE) -> None:
        super().__init__(text)
        self.problem = problem


class Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of one vehicle, in SI."""

    battery: BatteryParams = BatteryParams()
    battery_sim: BatterySimParams = BatterySimParams()
    commander: CommanderParams = CommanderParams()
    control: ControlParams = ControlParams()
    estimation: EstimatorParams = EstimatorParams()
    failure_detector: FailureDetectorParams = FailureDetectorParams()
    geofence: GeofenceParams = GeofenceParams()
    land_detector: LandDetectorParams = LandDetectorParams()
    navigation: NavigationParams = NavigationParams()
    sensors: SensorsParams = SensorsParams()


class Parameter(NamedTuple):
    """One row of the table."""

    name: str
    path: str
    """Path of the setting in `Settings`."""
    unit: str
    """PX4's unit, of value, range and default."""
    minimum: float
    maximum: float
    setting_per_unit: float = 1.0
    """Conversion factor from PX4's unit to the setting's."""
    is_integer: bool = False
    only_at_start: bool = False
    """It cannot change while the vehicle runs."""

    @property
    def group(self) -> str:
        """The package whose settings contain the value."""
        return self.path.partition(".")[0]


_DEG = math.pi / 180.0

TABLE = (
    Parameter("BAT1_CAPACITY", "battery.capacity_mah", "mAh", -1.0, 100_000.0),
    Parameter("BAT1_N_CELLS", "battery.cells", "", 1, 16, is_integer=True),
    Parameter("BAT1_R_INTERNAL", "battery.internal_resistance_ohm", "Ohm", -1.0, 0.2),
    Parameter("BAT1_V_CHARGED", "battery.charged_v", "V", 2.0, 5.0),
    Parameter("BAT1_V_EMPTY", "battery.empty_v", "V", 2.0, 5.0),
    Parameter("BAT_AVRG_CURRENT", "battery.average_current_a", "A", 0.0, 500.0),
    Parameter("BAT_CRIT_THR", "battery.critical", "norm", 0.0, 0.5),
    Parameter("BAT_EMERGEN_THR", "battery.emergency", "norm", 0.0, 0.5),
    Parameter("BAT_LOW_THR", "battery.low", "norm", 0.0, 0.5),
    Parameter("CA_FAILURE_MODE", "control.allocation.failure_mode", "", 0, 1, is_integer=True),
    Parameter("CBRK_FLIGHTTERM", "commander.termination_breaker", "", 0, 121_212, is_integer=True),
    Parameter("CF_DOB_ACC_MAX", "control.disturbance.acc_max_m_s2", "m/s^2", 0.1, 20.0),
    Parameter("CF_DOB_CUTOFF", "control.disturbance.cutoff_hz", "Hz", 0.1, 20.0),
    Parameter("CF_DOB_EN", "control.disturbance.enabled", "", 0, 1, is_integer=True),
    Parameter("CF_DOB_I_SHARE", "control.disturbance.integral_share", "", 0.0, 1.0),
    Parameter("COM_ACT_FAIL_ACT", "commander.motor_failure_action", "", 0, 4, is_integer=True),
    Parameter("COM_ARMABLE", "commander.armable", "", 0, 1, is_integer=True),
    Parameter("COM_ARM_BAT_MIN", "commander.arming_battery_min", "norm", -1.0, 0.9),
    Parameter("COM_DISARM_LAND", "commander.disarm_landed_s", "s", -1.0, 20.0),
    Parameter("COM_DISARM_PRFLT", "commander.disarm_preflight_s", "s", -1.0, 60.0),
    Parameter("COM_DLL_EXCEPT", "commander.gcs_loss_except", "", 0, 7, is_integer=True),
    Parameter("COM_DL_LOSS_T", "commander.gcs_loss_s", "s", 5.0, 300.0),
    Parameter("COM_FAIL_ACT_T", "commander.action_delay_s", "s", 0.0, 25.0),
    Parameter("COM_GNSSLOSS_ACT", "commander.gps_loss_action", "", 0, 3, is_integer=True),
    Parameter("COM_LOW_BAT_ACT", "commander.low_battery_action", "", 0, 3, is_integer=True),
    Parameter("COM_OBL_RC_ACT", "commander.offboard_loss_action", "", 0, 7, is_integer=True),
    Parameter("COM_OF_LOSS_T", "commander.offboard_loss_s", "s", 0.0, 60.0),
    Parameter("COM_POS_FS_EPH", "commander.pos_error_max_m", "m", -1.0, 400.0),
    Parameter("COM_RCL_EXCEPT", "commander.manual_loss_except", "", 0, 7, is_integer=True),
    Parameter("COM_RC_LOSS_T", "commander.manual_loss_s", "s", 0.0, 35.0),
    Parameter("COM_RC_OVERRIDE", "commander.stick_takeover", "", 0, 3, is_integer=True),
    Parameter("COM_RC_STICK_OV", "commander.stick_takeover_fraction", "%", 5.0, 80.0, 0.01),
    Parameter("COM_SPOOLUP_TIME", "commander.spool_up_s", "s", 0.0, 30.0),
    Parameter("COM_VEL_FS_EVH", "commander.vel_error_max_m_s", "m/s", 0.0, 5.0),
    Parameter("EKF2_ABIAS_INIT", "estimation.accel_bias_init_m_s2", "m/s^2", 0.001, 0.5),
    Parameter("EKF2_ABL_LIM", "estimation.accel_bias_limit_m_s2", "m/s^2", 0.001, 0.8),
    Parameter("EKF2_ACC_B_NOISE", "estimation.accel_bias_noise_m_s3", "m/s^3", 1e-6, 0.01),
    Parameter("EKF2_ACC_NOISE", "estimation.accel_noise_m_s2", "m/s^2", 0.01, 1.0),
    Parameter("EKF2_BARO_GATE", "estimation.baro_gate", "SD", 1.0, 100.0),
    Parameter("EKF2_BARO_NOISE", "estimation.baro_noise_m", "m", 0.01, 10.0),
    Parameter("EKF2_GPS_DELAY", "estimation.gps_delay_us", "ms", 0.0, 300.0, 1000.0, only_at_start=True),
    Parameter("EKF2_GPS_P_GATE", "estimation.gps_pos_gate", "SD", 1.0, 100.0),
    Parameter("EKF2_GPS_P_NOISE", "estimation.gps_pos_noise_m", "m", 0.01, 10.0),
    Parameter("EKF2_GPS_V_GATE", "estimation.gps_vel_gate", "SD", 1.0, 100.0),
    Parameter("EKF2_GPS_V_NOISE", "estimation.gps_vel_noise_m_s", "m/s", 0.01, 5.0),
    Parameter("EKF2_GYR_B_LIM", "estimation.gyro_bias_limit_rad_s", "rad/s", 0.001, 0.4),
    Parameter("EKF2_GYR_B_NOISE", "estimation.gyro_bias_noise_rad_s2", "rad/s^2", 1e-6, 0.01),
    Parameter("EKF2_GYR_NOISE", "estimation.gyro_noise_rad_s", "rad/s", 0.0001, 0.1),
    Parameter("EKF2_HDG_GATE", "estimation.heading_gate", "SD", 1.0, 100.0),
    Parameter("EKF2_MAG_CHECK", "estimation.mag_check", "", 0, 3, is_integer=True),
    Parameter("EKF2_MAG_CHK_INC", "estimation.mag_check_inclination_rad", "deg", 1.0, 180.0, _DEG),
    Parameter("EKF2_MAG_CHK_STR", "estimation.mag_check_strength_gauss", "gauss", 0.01, 10.0),
    Parameter("EKF2_MAG_NOISE", "estimation.mag_noise_gauss", "gauss", 0.001, 1.0),
    Parameter("EKF2_NOAID_NOISE", "estimation.no_aid_noise_m", "m", 0.5, 50.0),
    Parameter("EKF2_NOAID_TOUT", "estimation.no_aid_timeout_us", "us", 500_000, 10_000_000, is_integer=True),
    Parameter("EKF2_REQ_EPH", "estimation.gps_required_eph_m", "m", 2.0, 10.0),
    Parameter("EKF2_REQ_NSATS", "estimation.gps_required_satellites", "", 4, 12, is_integer=True),
    Parameter("FD_ACT_EN", "failure_detector.motor_check", "", 0, 1, is_integer=True),
    Parameter("FD_ACT_MOT_C2T", "failure_detector.motor_current_per_thrust_a", "A", 0.0, 50.0),
    Parameter("FD_ACT_MOT_THR", "failure_detector.motor_thrust_min", "norm", 0.0, 1.0),
    Parameter(
        "FD_ACT_MOT_TOUT", "failure_detector.motor_timeout_us", "ms", 10, 10_000, 1000.0, is_integer=True
    ),
    Parameter("FD_FAIL_P", "failure_detector.pitch_max_rad", "deg", 0.0, 180.0, _DEG),
    Parameter("FD_FAIL_P_TTRI", "failure_detector.pitch_trigger_s", "s", 0.02, 5.0),
    Parameter("FD_FAIL_R", "failure_detector.roll_max_rad", "deg", 0.0, 180.0, _DEG),
    Parameter("FD_FAIL_R_TTRI", "failure_detector.roll_trigger_s", "s", 0.02, 5.0),
    Parameter("GF_ACTION", "commander.geofence_action", "", 0, 5, is_integer=True),
    Parameter("GF_MAX_HOR_DIST", "geofence.max_horizontal_m", "m", 0.0, 10_000.0),
    Parameter("GF_MAX_VER_DIST", "geofence.max_vertical_m", "m", 0.0, 10_000.0),
    Parameter("GF_PREDICT", "geofence.predict", "", 0, 1, is_integer=True),
    Parameter("HTE_ACC_GATE", "control.hover_thrust.gate_sigma", "SD", 1.0, 10.0),
    Parameter("HTE_HT_ERR_INIT", "control.hover_thrust.initial_std", "norm", 0.01, 1.0),
    Parameter("HTE_HT_NOISE", "control.hover_thrust.process_noise_1_s", "1/s", 0.0001, 1.0),
    Parameter("HTE_THR_RANGE", "control.hover_thrust.range", "norm", 0.05, 0.4),
    Parameter("IMU_DGYRO_CUTOFF", "control.rate.derivative_cutoff_hz", "Hz", 1.0, 100.0),
    Parameter("LNDMC_ROT_MAX", "land_detector.rotation_max_rad_s", "deg/s", 1.0, 90.0, _DEG),
    Parameter("LNDMC_XY_VEL_MAX", "land_detector.horizontal_speed_max_m_s", "m/s", 0.1, 10.0),
    Parameter("LNDMC_Z_VEL_MAX", "land_detector.vertical_speed_max_m_s", "m/s", 0.05, 1.0),
    Parameter("MC_PITCHRATE_D", "control.rate.pitch_d", "", 0.0, 0.5),
    Parameter("MC_PITCHRATE_FF", "control.rate.pitch_ff", "", 0.0, 1.0),
    Parameter("MC_PITCHRATE_I", "control.rate.pitch_i", "", 0.0, 3.0),
    Parameter("MC_PITCHRATE_K", "control.rate.pitch_k", "", 0.01, 5.0),
    Parameter("MC_PITCHRATE_MAX", "control.attitude.pitch_rate_max_rad_s", "deg/s", 1.0, 1800.0, _DEG),
    Parameter("MC_PITCHRATE_P", "control.rate.pitch_p", "", 0.0, 0.6),
    Parameter("MC_PITCH_P", "control.attitude.pitch_p", "1/s", 0.0, 12.0),
    Parameter("MC_ROLLRATE_D", "control.rate.roll_d", "", 0.0, 0.5),
    Parameter("MC_ROLLRATE_FF", "control.rate.roll_ff", "", 0.0, 1.0),
    Parameter("MC_ROLLRATE_I", "control.rate.roll_i", "", 0.0, 3.0),
    Parameter("MC_ROLLRATE_K", "control.rate.roll_k", "", 0.01, 5.0),
    Parameter("MC_ROLLRATE_MAX", "control.attitude.roll_rate_max_rad_s", "deg/s", 1.0, 1800.0, _DEG),
    Parameter("MC_ROLLRATE_P", "control.rate.roll_p", "", 0.0, 0.6),
    Parameter("MC_ROLL_P", "control.attitude.roll_p", "1/s", 0.0, 12.0),
    Parameter("MC_YAWRATE_D", "control.rate.yaw_d", "", 0.0, 0.5),
    Parameter("MC_YAWRATE_FF", "control.rate.yaw_ff", "", 0.0, 1.0),
    Parameter("MC_YAWRATE_I", "control.rate.yaw_i", "", 0.0, 3.0),
    Parameter("MC_YAWRATE_K", "control.rate.yaw_k", "", 0.01, 5.0),
    Parameter("MC_YAWRATE_MAX", "control.attitude.yaw_rate_max_rad_s", "deg/s", 1.0, 1800.0, _DEG),
    Parameter("MC_YAWRATE_P", "control.rate.yaw_p", "", 0.0, 0.6),
    Parameter("MC_YAW_P", "control.attitude.yaw_p", "1/s", 0.0, 5.0),
    Parameter("MC_YAW_WEIGHT", "control.attitude.yaw_weight", "", 0.0, 1.0),
    Parameter("MIS_DIST_1WP", "navigation.first_place_max_m", "m", -1.0, 100_000.0),
    Parameter("MIS_TAKEOFF_ALT", "navigation.takeoff_height_m", "m", 0.5, 80.0),
    Parameter("MIS_YAW_ERR", "navigation.yaw_acceptance_rad", "deg", 1.0, 90.0, _DEG),
    Parameter("MPC_ACC_DOWN_MAX", "control.trajectory.acc_dn_m_s2", "m/s^2", 2.0, 15.0),
    Parameter("MPC_ACC_HOR", "control.trajectory.acc_xy_m_s2", "m/s^2", 2.0, 15.0),
    Parameter("MPC_ACC_UP_MAX", "control.trajectory.acc_up_m_s2", "m/s^2", 2.0, 15.0),
    Parameter("MPC_HOLD_DZ", "navigation.manual.deadzone", "norm", 0.0, 0.9),
    Parameter("MPC_HOLD_MAX_XY", "navigation.manual.hold_max_xy_m_s", "m/s", 0.0, 3.0),
    Parameter("MPC_HOLD_MAX_Z", "navigation.manual.hold_max_z_m_s", "m/s", 0.0, 3.0),
    Parameter("MPC_JERK_AUTO", "control.trajectory.jerk_m_s3", "m/s^3", 1.0, 80.0),
    Parameter("MPC_JERK_MAX", "navigation.manual.jerk_m_s3", "m/s^3", 0.5, 500.0),
    Parameter("MPC_LAND_ALT1", "navigation.land_fast_height_m", "m", 0.1, 122.0),
    Parameter("MPC_LAND_ALT2", "navigation.land_slow_height_m", "m", 0.1, 122.0),
    Parameter("MPC_LAND_SPEED", "navigation.land_speed_m_s", "m/s", 0.6, 3.0),
    Parameter("MPC_MANTHR_MIN", "navigation.manual.thrust_min", "norm", 0.0, 1.0),
    Parameter("MPC_MAN_TILT_MAX", "navigation.manual.tilt_max_rad", "deg", 1.0, 70.0, _DEG),
    Parameter("MPC_MAN_Y_MAX", "navigation.manual.yaw_rate_max_rad_s", "deg/s", 0.0, 400.0, _DEG),
    Parameter("MPC_MAN_Y_TAU", "navigation.manual.yaw_rate_filter_s", "s", 0.0, 5.0),
    Parameter("MPC_THR_HOVER", "control.position.thr_hover", "norm", 0.1, 0.8),
    Parameter("MPC_THR_MAX", "control.position.thr_max", "norm", 0.1, 1.0),
    Parameter("MPC_THR_MIN", "control.position.thr_min", "norm", 0.05, 0.5),
    Parameter("MPC_THR_XY_MARG", "control.position.thr_xy_margin", "norm", 0.0, 0.5),
    Parameter("MPC_TILTMAX_AIR", "control.position.tilt_max_rad", "deg", 20.0, 89.0, _DEG),
    Parameter("MPC_TKO_RAMP_T", "control.position.tko_ramp_s", "s", 0.1, 5.0),
    Parameter("MPC_TKO_SPEED", "control.position.tko_speed_m_s", "m/s", 0.5, 5.0),
    Parameter("MPC_VELD_LP", "control.position.acc_cutoff_hz", "Hz", 0.5, 50.0),
    Parameter("MPC_VEL_MANUAL", "navigation.manual.xy_speed_m_s", "m/s", 3.0, 20.0),
    Parameter("MPC_XY_CRUISE", "control.trajectory.xy_cruise_m_s", "m/s", 3.0, 20.0),
    Parameter("MPC_XY_ERR_MAX", "control.trajectory.xy_error_max_m", "m", 0.1, 10.0),
    Parameter("MPC_XY_MAN_EXPO", "navigation.manual.xy_expo", "", 0.0, 1.0),
    Parameter("MPC_XY_P", "control.position.xy_p", "1/s", 0.0, 2.0),
    Parameter("MPC_XY_VEL_D_ACC", "control.position.xy_vel_d_acc", "", 0.0, 2.0),
    Parameter("MPC_XY_VEL_I_ACC", "control.position.xy_vel_i_acc", "1/s^2", 0.0, 60.0),
    Parameter("MPC_XY_VEL_MAX", "control.position.xy_vel_max_m_s", "m/s", 0.1, 20.0),
    Parameter("MPC_XY_VEL_P_ACC", "control.position.xy_vel_p_acc", "1/s", 1.2, 5.0),
    Parameter("MPC_YAWRAUTO_ACC", "control.trajectory.yaw_acc_max_rad_s2", "deg/s^2", 5.0, 360.0, _DEG),
    Parameter("MPC_YAWRAUTO_MAX", "control.trajectory.yaw_rate_max_rad_s", "deg/s", 5.0, 360.0, _DEG),
    Parameter("MPC_YAW_EXPO", "navigation.manual.yaw_expo", "", 0.0, 1.0),
    Parameter("MPC_YAW_MODE", "navigation.yaw_mode", "", 0, 3, is_integer=True),
    Parameter("MPC_Z_MAN_EXPO", "navigation.manual.z_expo", "", 0.0, 1.0),
    Parameter("MPC_Z_P", "control.position.z_p", "1/s", 0.1, 1.5),
    Parameter("MPC_Z_VEL_D_ACC", "control.position.z_vel_d_acc", "", 0.0, 2.0),
    Parameter("MPC_Z_VEL_I_ACC", "control.position.z_vel_i_acc", "1/s^2", 0.2, 3.0),
    Parameter("MPC_Z_VEL_MAX_DN", "control.position.z_vel_max_dn_m_s", "m/s", 0.5, 4.0),
    Parameter("MPC_Z_VEL_MAX_UP", "control.position.z_vel_max_up_m_s", "m/s", 0.5, 8.0),
    Parameter("MPC_Z_VEL_P_ACC", "control.position.z_vel_p_acc", "1/s", 2.0, 15.0),
    Parameter("MPC_Z_V_AUTO_DN", "control.trajectory.z_vel_dn_m_s", "m/s", 0.5, 4.0),
    Parameter("MPC_Z_V_AUTO_UP", "control.trajectory.z_vel_up_m_s", "m/s", 0.5, 8.0),
    Parameter("NAV_ACC_RAD", "navigation.acceptance_m", "m", 0.05, 200.0),
    Parameter("NAV_DLL_ACT", "commander.gcs_loss_action", "", 0, 6, is_integer=True),
    Parameter("NAV_MC_ALT_RAD", "navigation.altitude_acceptance_m", "m", 0.05, 200.0),
    Parameter("NAV_RCL_ACT", "commander.manual_loss_action", "", 0, 6, is_integer=True),
    Parameter("RTL_CONE_ANG", "navigation.return_home.cone_half_angle_rad", "deg", 0.0, 90.0, _DEG),
    Parameter("RTL_DESCEND_ALT", "navigation.return_home.descend_height_m", "m", 0.0, 1_000.0),
    Parameter("RTL_LAND_DELAY", "navigation.return_home.land_delay_s", "s", -1.0, 3_600.0),
    Parameter("RTL_MIN_DIST", "navigation.return_home.min_distance_m", "m", 0.0, 1_000.0),
    Parameter("RTL_RETURN_ALT", "navigation.return_home.height_m", "m", 0.0, 1_000.0),
    Parameter("SENS_BARO_RATE", "sensors.baro_rate_hz", "Hz", 1.0, 200.0),
    Parameter("SENS_MAG_RATE", "sensors.mag_rate_hz", "Hz", 1.0, 200.0),
    Parameter("SIM_BAT_DRAIN", "battery_sim.drain_s", "s", 0.0, 86_400.0),
    Parameter("SIM_BAT_ENABLE", "battery_sim.enabled", "", 0, 1, is_integer=True),
    Parameter("SIM_BAT_MIN_PCT", "battery_sim.minimum", "%", 0.0, 100.0, 0.01),
    Parameter("THR_MDL_FAC", "control.allocation.thrust_model_factor", "", 0.0, 1.0),
)
"""Sorted by name. CF_* are coflight's own."""

INDEX_OF = {parameter.name: index for index, parameter in enumerate(TABLE)}

Row = Parameter | Stated


def _name(row: Row) -> str:
    return row.name


ROWS: tuple[Row, ...] = tuple(sorted((*TABLE, *STATED), key=_name))
"""With and without effect, sorted by name; the position is the index in MAVLink's parameter protocol."""
ROW_INDEX_OF = {row.name: index for index, row in enumerate(ROWS)}

NOT_OVER = (
    ("BAT_CRIT_THR", "BAT_LOW_THR"),
    ("BAT_EMERGEN_THR", "BAT_CRIT_THR"),
    ("MPC_LAND_ALT2", "MPC_LAND_ALT1"),
    ("MPC_THR_MIN", "MPC_THR_MAX"),
)
UNDER = (("BAT1_V_EMPTY", "BAT1_V_CHARGED"),)
"""Pairs with equal units of which the first must be at most, or less than, the second."""


class _Subscription(NamedTuple):
    """A part that uses some groups of the settings."""

    apply: Callable[..., None]
    groups: tuple[Callable[[Settings], Struct], ...]


class ParameterSet:
    """Current values of the parameters and the settings derived from them.

    Parts `subscribe` to the groups of settings that they use; a change is passed to them before `set` or
    `reset` returns, in the order of the subscriptions.
    """

    def __init__(
        self,
        settings: Settings,
        overrides: Mapping[str, float] | None = None,
        *,
        system: int = 1,
        vehicle: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Start from ``settings`` and apply ``overrides``. Raises ParameterError.

        The order of pairs is checked after all changes, so the order of ``overrides`` does not matter.
        ``system`` is the vehicle's MAVLink system id, ``vehicle`` has values of parameters without effect.
        """
        self.settings = self._defaults = settings
        own = {"MAV_SYS_ID": float(system), **vehicle}
        self._stated_defaults = {row.name: row.default for row in STATED} | own
        self.stated = dict(self._stated_defaults)
        """Values of the parameters without effect."""
        self.version = 0
        """Increases with every change."""
        self._subscriptions: list[_Subscription] = []
        self._reports: list[Callable[[str], None]] = []
        for name, value in (overrides or {}).items():
            self._change(name, value)
        _check_order(self.settings)

    def subscribe(self, apply: Callable[..., None], *groups: str) -> None:
        """Call ``apply`` with these groups of the settings when a value in one of them changes.

        A group is a path in `Settings`, such as ``estimation`` or ``control.trajectory``. Raises
        AttributeError for another path.
        """
        getters = tuple(attrgetter(group) for group in groups)
        for getter in getters:
            getter(self.settings)
        self._subscriptions.append(_Subscription(apply, getters))

    def report_to(self, report: Callable[[str], None]) -> None:
        """Call ``report`` with the name of each parameter that `set` or `reset` has changed."""
        self._reports.append(report)

    def get(self, name: str) -> float:
        """Value in PX4's unit. Raises ParameterError for an unknown name."""
        if name in self.stated:
            return self.stated[name]
        parameter = _find(name)
        return _setting(self.settings, parameter) / parameter.setting_per_unit

    def default(self, name: str) -> float:
        """Value before any overrides, in PX4's unit. Raises ParameterError for an unknown name."""
        if name in self._stated_defaults:
            return self._stated_defaults[name]
        parameter = _find(name)
        return _setting(self._defaults, parameter) / parameter.setting_per_unit

    def set(self, name: str, value: float) -> None:
        """Change a value, given in PX4's unit. Raises ParameterError; then nothing is changed."""
        if _only_at_start(name):
            raise ParameterError(f"{name} can only be set at the start", ParameterProblem.READ_ONLY)
        before = self.settings
        self._change(name, value)
        if self.settings is not before:
            try:
                _check_order(self.settings, name)
            except ParameterError:
                self.settings = before
                raise
        self._publish(before, [name])

    def reset(self, names: Iterable[str]) -> None:
        """Reset parameters to their values before any overrides.

        Read-only ones and those that can only be set at the start are left. Raises ParameterError if the
        result is inconsistent with the other parameters; then nothing is changed.
        """
        before, stated, changed = self.settings, dict(self.stated), []
        settings = before
        for name in names:
            if name in stated:
                if not STATED_OF[name].read_only and stated[name] != self._stated_defaults[name]:
                    stated[name] = self._stated_defaults[name]
                    changed.append(name)
                continue
            if _only_at_start(name):
                continue
            parameter = _find(name)
            default = _setting(self._defaults, parameter)
            if _setting(settings, parameter) != default:
                settings = _with(settings, parameter.path.split("."), default)
                changed.append(name)
        _check_order(settings)
        self.settings, self.stated = settings, stated
        self._publish(before, changed)

    def _publish(self, before: Settings, names: Iterable[str]) -> None:
        """Pass the groups that are not those of before to their subscribers, and report the names."""
        self.version += 1
        settings = self.settings
        for apply, groups in self._subscriptions if settings is not before else ():
            present = [group(settings) for group in groups]
            if any(new is not group(before) for new, group in zip(present, groups, strict=True)):
                apply(*present)
        for name in names:
            for report in self._reports:
                report(name)

    def _change(self, name: str, value: float) -> None:
        """Change one value without a check against the others. Raises ParameterError."""
        check_range(name, value)
        if name not in self.stated:
            self.settings = _changed(self.settings, name, value)
        elif STATED_OF[name].read_only:
            raise ParameterError(f"parameter {name} is read only", ParameterProblem.READ_ONLY)
        else:
            self.stated[name] = value


def check_range(name: str, value: float) -> None:
    """Raise ParameterError unless the parameter exists and the value is in its range."""
    index = ROW_INDEX_OF.get(name)
    if index is None:
        raise _unknown(name)
    row = ROWS[index]
    if not row.minimum <= value <= row.maximum:  # also refuses NaN
        limits = f"{row.minimum:g} .. {row.maximum:g} {row.unit}".rstrip()
        raise ParameterError(f"parameter {name} = {value:g} is outside {limits}")
    if row.is_integer and value != round(value):
        raise ParameterError(f"parameter {name} = {value:g} is not a whole number")


def _only_at_start(name: str) -> bool:
    index = INDEX_OF.get(name)
    return index is not None and TABLE[index].only_at_start


def _find(name: str) -> Parameter:
    index = INDEX_OF.get(name)
    if index is None:
        raise _unknown(name)
    return TABLE[index]


def _unknown(name: str) -> ParameterError:
    return ParameterError(f"there is no parameter {name!r}", ParameterProblem.UNKNOWN)


def _setting(settings: Settings, parameter: Parameter) -> float:
    setting: float = attrgetter(parameter.path)(settings)
    return setting


def _changed(settings: Settings, name: str, value: float) -> Settings:
    """Settings with one value, in PX4's unit and within its range, changed."""
    parameter = _find(name)
    setting = value * parameter.setting_per_unit
    kind = type(_setting(settings, parameter))
    return _with(settings, parameter.path.split("."), setting if kind is float else kind(round(setting)))


def _check_order(settings: Settings, name: str | None = None) -> None:
    """Raise ParameterError for a pair in the wrong order, among all or those with one parameter."""
    for pairs, strictly in ((NOT_OVER, False), (UNDER, True)):
        for pair in pairs:
            if name is not None and name not in pair:
                continue
            low, high = (_setting(settings, _find(one)) for one in pair)
            if low > high or (strictly and low == high):
                relation = "less than" if strictly else "at most"
                raise ParameterError(f"parameter {pair[0]} = {low:g} must be {relation} {pair[1]} = {high:g}")


S = TypeVar("S", bound=Struct)


def _with(struct: S, path: list[str], value: float) -> S:
    """Copy of a struct with the value at a path of nested structs replaced."""
    head, *rest = path
    return structs.replace(struct, **{head: _with(getattr(struct, head), rest, value) if rest else value})

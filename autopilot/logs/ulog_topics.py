"""Topics of a vehicle's ULog: PX4's names, definitions of v1.17, and periods of its default logger.

The fields of a message are those of ``msg/*.msg`` in the order in which uORB logs them: largest types first,
so that no padding is needed. Periods are those that `logged_topics.cpp` gives the default profile on a board,
where the last of several for one topic counts; ground truth as with SYS_HITL. A topic that PX4 publishes on
changes has the period at which it repeats it.
"""

from struct import Struct
from typing import Any, NamedTuple

import numpy as np

_KINDS = {
    "uint64_t": ("Q", "<u8"), "double": ("d", "<f8"), "float": ("f", "<f4"), "uint32_t": ("I", "<u4"),
    "int32_t": ("i", "<i4"), "uint16_t": ("H", "<u2"), "uint8_t": ("B", "u1"), "bool": ("?", "?"),
}  # fmt: skip
"""Codes of `struct` and NumPy by type."""
MESSAGE_HEADER = np.dtype([("size", "<u2"), ("kind", "u1"), ("topic", "<u2"), ("timestamp", "<u8")])
"""Begin of a data message: size without its first three bytes, the letter D, number of the subscription, time
in us."""
DATA = ord("D")
_NOT_COUNTED = 3


class Field(NamedTuple):
    """A field of a message."""

    name: str
    kind: str
    """Type as ULog names it."""
    elements: int
    """Number of elements of an array; 0: a single value."""

    @property
    def definition(self) -> str:
        """Text of the field in a format definition."""
        return f"{self.kind}[{self.elements}] {self.name}" if self.elements else f"{self.kind} {self.name}"


def _fields(*groups: str) -> tuple[Field, ...]:
    """Return the fields of groups of one type, ``type name name ...``."""
    found = []
    for group in groups:
        kind, *names = group.split(" ")
        base, _, count = kind.rstrip("]").partition("[")
        found += [Field(name, base, int(count or 0)) for name in names]
    return tuple(found)


class Topic(NamedTuple):
    """A topic by PX4's name, with the fields of its samples after the timestamp, in order."""

    name: str
    fields: tuple[Field, ...]
    period_us: int
    """Least time between two samples; 0: each that there is."""

    @property
    def format(self) -> str:
        """Text of the format definition."""
        return f"{self.name}:uint64_t timestamp;" + "".join(f"{field.definition};" for field in self.fields)

    @property
    def layout(self) -> Struct:
        """Layout of a data message: header, then the fields."""
        codes = "".join(
            (str(field.elements) if field.elements else "") + _KINDS[field.kind][0] for field in self.fields
        )
        return Struct("<HBHQ" + codes)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The same as a packed structured dtype, for many samples at once."""
        header = [(name, MESSAGE_HEADER[name]) for name in MESSAGE_HEADER.names or ()]
        return np.dtype(
            header
            + [
                (field.name, _KINDS[field.kind][1], (field.elements,) if field.elements else ())
                for field in self.fields
            ]
        )

    @property
    def size(self) -> int:
        """Size of a data message as its header states it."""
        return self.layout.size - _NOT_COUNTED


_SENSOR_COMBINED = _fields(
    "float[3] gyro_rad",
    "uint32_t gyro_integral_dt",
    "int32_t accelerometer_timestamp_relative",
    "float[3] accelerometer_m_s2",
    "uint32_t accelerometer_integral_dt",
    "uint8_t accelerometer_clipping gyro_clipping accel_calibration_count gyro_calibration_count",
)
_VEHICLE_ANGULAR_VELOCITY = _fields(
    "uint64_t timestamp_sample",
    "float[3] xyz xyz_derivative",
)
_VEHICLE_RATES_SETPOINT = _fields(
    "float roll pitch yaw",
    "float[3] thrust_body",
    "bool reset_integral",
)
_VEHICLE_TORQUE_SETPOINT = _fields(
    "uint64_t timestamp_sample",
    "float[3] xyz",
)
_VEHICLE_THRUST_SETPOINT = _fields(
    "uint64_t timestamp_sample",
    "float[3] xyz",
)
_VEHICLE_ATTITUDE = _fields(
    "uint64_t timestamp_sample",
    "float[4] q delta_q_reset",
    "uint8_t quat_reset_counter",
)
_VEHICLE_ACCELERATION = _fields(
    "uint64_t timestamp_sample",
    "float[3] xyz",
)
_VEHICLE_IMU_STATUS = _fields(
    "uint32_t accel_device_id gyro_device_id",
    "uint32_t[3] accel_clipping gyro_clipping",
    "uint32_t accel_error_count gyro_error_count",
    "float accel_rate_hz gyro_rate_hz accel_raw_rate_hz gyro_raw_rate_hz accel_vibration_metric "
    "gyro_vibration_metric delta_angle_coning_metric",
    "float[3] mean_accel mean_gyro var_accel var_gyro",
    "float temperature_accel temperature_gyro",
)
_VEHICLE_ATTITUDE_SETPOINT = _fields(
    "float yaw_sp_move_rate",
    "float[4] q_d",
    "float[3] thrust_body",
)
_VEHICLE_LOCAL_POSITION = _fields(
    "uint64_t timestamp_sample ref_timestamp",
    "double ref_lat ref_lon",
    "float x y z",
    "float[2] delta_xy",
    "float delta_z vx vy vz z_deriv",
    "float[2] delta_vxy",
    "float delta_vz ax ay az heading heading_var unaided_heading delta_heading tilt_var ref_alt "
    "dist_bottom dist_bottom_var delta_dist_bottom eph epv evh evv vxy_max vz_max hagl_min hagl_max_z "
    "hagl_max_xy",
    "bool xy_valid z_valid v_xy_valid v_z_valid",
    "uint8_t xy_reset_counter z_reset_counter vxy_reset_counter vz_reset_counter heading_reset_counter",
    "bool heading_good_for_control xy_global z_global dist_bottom_valid",
    "uint8_t dist_bottom_reset_counter dist_bottom_sensor_bitfield",
    "bool dead_reckoning",
)
_VEHICLE_LOCAL_POSITION_SETPOINT = _fields(
    "float x y z vx vy vz",
    "float[3] acceleration thrust",
    "float yaw yawspeed",
)
_VEHICLE_GLOBAL_POSITION = _fields(
    "uint64_t timestamp_sample",
    "double lat lon",
    "float alt alt_ellipsoid delta_alt delta_terrain eph epv terrain_alt",
    "bool lat_lon_valid alt_valid",
    "uint8_t lat_lon_reset_counter alt_reset_counter terrain_reset_counter",
    "bool terrain_alt_valid dead_reckoning",
)
_TRAJECTORY_SETPOINT = _fields(
    "float[3] position velocity acceleration jerk",
    "float yaw yawspeed",
)
_ACTUATOR_MOTORS = _fields(
    "uint64_t timestamp_sample",
    "float[12] control",
    "uint16_t reversible_flags",
)
_ACTUATOR_OUTPUTS = _fields(
    "uint32_t noutputs",
    "float[16] output",
)
_HOVER_THRUST_ESTIMATE = _fields(
    "uint64_t timestamp_sample",
    "float hover_thrust hover_thrust_var accel_innov accel_innov_var accel_innov_test_ratio accel_noise_var",
    "bool valid",
)
_RATE_CTRL_STATUS = _fields(
    "float rollspeed_integ pitchspeed_integ yawspeed_integ",
)
_SENSOR_GPS = _fields(
    "uint64_t timestamp_sample",
    "double latitude_deg longitude_deg altitude_msl_m altitude_ellipsoid_m",
    "uint64_t time_utc_usec",
    "uint32_t device_id",
    "float s_variance_m_s c_variance_rad eph epv hdop vdop",
    "int32_t noise_per_ms jamming_indicator",
    "float vel_m_s vel_n_m_s vel_e_m_s vel_d_m_s cog_rad",
    "int32_t timestamp_time_relative",
    "uint32_t system_error",
    "float heading heading_offset heading_accuracy rtcm_injection_rate",
    "uint16_t automatic_gain_control",
    "uint8_t fix_type jamming_state spoofing_state authentication_state",
    "bool vel_ned_valid",
    "uint8_t satellites_used selected_rtcm_instance",
    "bool rtcm_crc_failed",
    "uint8_t rtcm_msg_used",
)
_VEHICLE_AIR_DATA = _fields(
    "uint64_t timestamp_sample",
    "uint32_t baro_device_id",
    "float baro_alt_meter baro_pressure_pa ambient_temperature rho",
    "uint8_t temperature_source calibration_count",
)
_SENSOR_BARO = _fields(
    "uint64_t timestamp_sample",
    "uint32_t device_id",
    "float pressure temperature",
    "uint32_t error_count",
)
_VEHICLE_MAGNETOMETER = _fields(
    "uint64_t timestamp_sample",
    "uint32_t device_id",
    "float[3] magnetometer_ga",
    "uint8_t calibration_count",
)
_ESTIMATOR_STATUS = _fields(
    "uint64_t timestamp_sample control_mode_flags",
    "float[3] output_tracking_error",
    "uint32_t filter_fault_flags",
    "float pos_horiz_accuracy pos_vert_accuracy hdg_test_ratio vel_test_ratio pos_test_ratio "
    "hgt_test_ratio tas_test_ratio hagl_test_ratio beta_test_ratio time_slip",
    "uint32_t accel_device_id gyro_device_id baro_device_id mag_device_id",
    "float mag_inclination_deg mag_inclination_ref_deg mag_strength_gs mag_strength_ref_gs",
    "uint16_t gps_check_fail_flags solution_status_flags",
    "uint8_t reset_count_vel_ne reset_count_vel_d reset_count_pos_ne reset_count_pod_d reset_count_quat",
    "bool pre_flt_fail_innov_heading pre_flt_fail_innov_height pre_flt_fail_innov_pos_horiz "
    "pre_flt_fail_innov_vel_horiz pre_flt_fail_innov_vel_vert pre_flt_fail_mag_field_disturbed",
    "uint8_t health_flags timeout_flags",
)
_ESTIMATOR_INNOVATIONS = _fields(
    "uint64_t timestamp_sample",
    "float[2] gps_hvel",
    "float gps_vvel",
    "float[2] gps_hpos",
    "float gps_vpos",
    "float[2] ev_hvel",
    "float ev_vvel",
    "float[2] ev_hpos",
    "float ev_vpos rng_vpos baro_vpos",
    "float[2] aux_hvel flow",
    "float heading",
    "float[3] mag_field gravity",
    "float[2] drag",
    "float airspeed beta hagl hagl_rate",
)
_ESTIMATOR_STATES = _fields(
    "uint64_t timestamp_sample",
    "float[25] states",
    "float[24] covariances",
    "uint8_t n_states",
)
_ESTIMATOR_SENSOR_BIAS = _fields(
    "uint64_t timestamp_sample",
    "uint32_t gyro_device_id",
    "float[3] gyro_bias",
    "float gyro_bias_limit",
    "float[3] gyro_bias_variance",
    "uint32_t accel_device_id",
    "float[3] accel_bias",
    "float accel_bias_limit",
    "float[3] accel_bias_variance",
    "uint32_t mag_device_id",
    "float[3] mag_bias",
    "float mag_bias_limit",
    "float[3] mag_bias_variance",
    "bool gyro_bias_valid gyro_bias_stable accel_bias_valid accel_bias_stable mag_bias_valid mag_bias_stable",
)
_BATTERY_STATUS = _fields(
    "float voltage_v current_a current_average_a discharged_mah remaining scale time_remaining_s temperature",
    "float[14] voltage_cell_v",
    "float max_cell_voltage_delta full_charge_capacity_wh remaining_capacity_wh nominal_voltage "
    "internal_resistance_estimate ocv_estimate ocv_estimate_filtered volt_based_soc_estimate "
    "voltage_prediction prediction_error estimation_covariance_norm",
    "uint16_t capacity cycle_count average_time_to_empty manufacture_date state_of_health max_error "
    "interface_error faults over_discharge_count",
    "bool connected",
    "uint8_t cell_count source priority id",
    "bool is_powering_off is_required",
    "uint8_t warning",
)
_MANUAL_CONTROL_SETPOINT = _fields(
    "uint64_t timestamp_sample",
    "float roll pitch yaw throttle flaps aux1 aux2 aux3 aux4 aux5 aux6",
    "uint16_t buttons",
    "bool valid",
    "uint8_t data_source",
    "bool sticks_moving",
)
_VEHICLE_LAND_DETECTED = _fields(
    "bool freefall ground_contact maybe_landed landed in_ground_effect in_descend has_low_throttle "
    "vertical_movement horizontal_movement rotational_movement close_to_ground_or_skipped_check at_rest",
)
_VEHICLE_STATUS = _fields(
    "uint64_t armed_time takeoff_time nav_state_timestamp",
    "uint32_t valid_nav_states_mask can_set_nav_states_mask",
    "uint16_t failure_detector_status",
    "uint8_t arming_state latest_arming_reason latest_disarming_reason nav_state_user_intention "
    "nav_state executor_in_charge hil_state vehicle_type",
    "bool failsafe failsafe_and_user_took_over",
    "uint8_t failsafe_defer_state",
    "bool gcs_connection_lost",
    "uint8_t gcs_connection_lost_counter",
    "bool high_latency_data_link_lost is_vtol is_vtol_tailsitter in_transition_mode in_transition_to_fw",
    "uint8_t system_type system_id component_id",
    "bool safety_button_available safety_off power_input_valid usb_connected "
    "open_drone_id_system_present open_drone_id_system_healthy parachute_system_present "
    "parachute_system_healthy rc_calibration_in_progress calibration_enabled pre_flight_checks_pass",
)
_FAILSAFE_FLAGS = _fields(
    "uint32_t mode_req_angular_velocity mode_req_attitude mode_req_local_alt mode_req_local_position "
    "mode_req_local_position_relaxed mode_req_global_position mode_req_global_position_relaxed "
    "mode_req_mission mode_req_offboard_signal mode_req_home_position "
    "mode_req_wind_and_flight_time_compliance mode_req_prevent_arming mode_req_manual_control "
    "mode_req_other",
    "bool angular_velocity_invalid attitude_invalid local_altitude_invalid local_position_invalid "
    "local_position_invalid_relaxed local_velocity_invalid global_position_invalid "
    "global_position_invalid_relaxed auto_mission_missing offboard_control_signal_lost "
    "home_position_invalid manual_control_signal_lost gcs_connection_lost",
    "uint8_t battery_warning",
    "bool battery_low_remaining_time battery_unhealthy geofence_breached mission_failure "
    "vtol_fixed_wing_system_failure wind_limit_exceeded flight_time_limit_exceeded "
    "position_accuracy_low navigator_failure fd_critical_failure fd_esc_arming_failure "
    "fd_imbalanced_prop fd_motor_failure",
)
_HOME_POSITION = _fields(
    "double lat lon",
    "float alt x y z roll pitch yaw",
    "uint32_t update_count",
    "bool valid_alt valid_hpos valid_lpos manual_home",
)

TOPICS = (
    Topic("sensor_combined", _SENSOR_COMBINED, 0),
    Topic("vehicle_angular_velocity", _VEHICLE_ANGULAR_VELOCITY, 20_000),
    Topic("vehicle_rates_setpoint", _VEHICLE_RATES_SETPOINT, 20_000),
    Topic("vehicle_torque_setpoint", _VEHICLE_TORQUE_SETPOINT, 20_000),
    Topic("vehicle_thrust_setpoint", _VEHICLE_THRUST_SETPOINT, 20_000),
    Topic("vehicle_attitude", _VEHICLE_ATTITUDE, 50_000),
    Topic("vehicle_acceleration", _VEHICLE_ACCELERATION, 50_000),
    Topic("vehicle_imu_status", _VEHICLE_IMU_STATUS, 1_000_000),
    Topic("vehicle_attitude_setpoint", _VEHICLE_ATTITUDE_SETPOINT, 50_000),
    Topic("vehicle_local_position", _VEHICLE_LOCAL_POSITION, 100_000),
    Topic("vehicle_local_position_setpoint", _VEHICLE_LOCAL_POSITION_SETPOINT, 100_000),
    Topic("vehicle_global_position", _VEHICLE_GLOBAL_POSITION, 200_000),
    Topic("trajectory_setpoint", _TRAJECTORY_SETPOINT, 200_000),
    Topic("actuator_motors", _ACTUATOR_MOTORS, 100_000),
    Topic("actuator_outputs", _ACTUATOR_OUTPUTS, 100_000),
    Topic("hover_thrust_estimate", _HOVER_THRUST_ESTIMATE, 100_000),
    Topic("rate_ctrl_status", _RATE_CTRL_STATUS, 200_000),
    Topic("vehicle_gps_position", _SENSOR_GPS, 100_000),
    Topic("sensor_gps", _SENSOR_GPS, 1_000_000),
    Topic("vehicle_air_data", _VEHICLE_AIR_DATA, 200_000),
    Topic("sensor_baro", _SENSOR_BARO, 1_000_000),
    Topic("vehicle_magnetometer", _VEHICLE_MAGNETOMETER, 500_000),
    Topic("estimator_status", _ESTIMATOR_STATUS, 200_000),
    Topic("estimator_innovations", _ESTIMATOR_INNOVATIONS, 500_000),
    Topic("estimator_innovation_variances", _ESTIMATOR_INNOVATIONS, 500_000),
    Topic("estimator_innovation_test_ratios", _ESTIMATOR_INNOVATIONS, 500_000),
    Topic("estimator_states", _ESTIMATOR_STATES, 500_000),
    Topic("estimator_sensor_bias", _ESTIMATOR_SENSOR_BIAS, 1_000_000),
    Topic("battery_status", _BATTERY_STATUS, 200_000),
    Topic("manual_control_setpoint", _MANUAL_CONTROL_SETPOINT, 200_000),
    Topic("vehicle_land_detected", _VEHICLE_LAND_DETECTED, 1_000_000),
    Topic("vehicle_status", _VEHICLE_STATUS, 500_000),
    Topic("failsafe_flags", _FAILSAFE_FLAGS, 500_000),
    Topic("home_position", _HOME_POSITION, 0),
)
"""Written by the vehicle; indexed by the number of the subscription."""
TRUTH_TOPICS = (
    Topic("vehicle_angular_velocity_groundtruth", _VEHICLE_ANGULAR_VELOCITY, 10_000),
    Topic("vehicle_attitude_groundtruth", _VEHICLE_ATTITUDE, 10_000),
    Topic("vehicle_local_position_groundtruth", _VEHICLE_LOCAL_POSITION, 20_000),
    Topic("vehicle_global_position_groundtruth", _VEHICLE_GLOBAL_POSITION, 100_000),
)
"""Added by the report, from the simulator's truth; their subscriptions follow those of `TOPICS`."""
NUMBER_OF = {topic.name: number for number, topic in enumerate(TOPICS + TRUTH_TOPICS)}
"""Number of the subscription by name."""

"""PX4 parameters without effect, which ground stations' pages expect.

They are listed, stored and saved like the others, so that no page is empty and a station's file loads
completely. Defaults are PX4's for its simulated Iris, except where those would be wrong for this vehicle.
"""

from typing import NamedTuple


class Stated(NamedTuple):
    """One parameter: PX4's name and its meaning in PX4."""

    name: str
    default: float
    meaning: str
    minimum: float
    maximum: float
    unit: str = ""
    is_integer: bool = True
    read_only: bool = False
    """Describes the vehicle, and cannot be changed by a station."""


_LARGEST_ID = 2**24 - 1


def _sensors() -> list[Stated]:
    """Device ids of the sensors; stations take 0 for a sensor that is not calibrated."""
    rows = [
        Stated("CAL_ACC0_ID", 1_310_988, "Device id of the calibrated accelerometer", 0, _LARGEST_ID),
        Stated("CAL_ACC0_PRIO", 50, "Priority of the accelerometer", -1, 100),
        Stated("CAL_GYRO0_ID", 1_310_988, "Device id of the calibrated gyroscope", 0, _LARGEST_ID),
        Stated("CAL_GYRO0_PRIO", 50, "Priority of the gyroscope", -1, 100),
        Stated("CAL_MAG0_PRIO", 50, "Priority of the magnetometer", -1, 100),
        Stated("CAL_MAG_SIDES", 63, "Bit mask of the sides of a magnetometer calibration", 34, 63),
    ]
    for number, device in enumerate((197_388, 0, 0, 0)):
        rows += [
            Stated(f"CAL_MAG{number}_ID", device, "Device id of the calibrated magnetometer", 0, _LARGEST_ID),
            Stated(f"CAL_MAG{number}_ROT", -1, "Rotation of the magnetometer; -1: as the board", -1, 40),
        ]
    for axis, default in (("X", 1e-6), ("Y", 0.0), ("Z", 0.0)):
        meaning = f"Rotation of the board about {axis.lower()}"
        name = f"SENS_BOARD_{axis}_OFF"
        rows.append(Stated(name, default, meaning, -45.0, 45.0, "deg", is_integer=False))
    return rows


def _remote_control() -> list[Stated]:
    """Channel assignment of a radio control; 0: none."""
    uses = (
        "ROLL", "PITCH", "THROTTLE", "YAW", "FLTMODE", "RETURN_SW", "KILL_SW", "OFFB_SW", "LOITER_SW",
        "ARM_SW", "GEAR_SW", "TRANS_SW", "ENG_MOT", "PAY_SW", "FLAPS", "AUX1", "AUX2", "AUX3", "AUX4",
        "AUX5", "AUX6", "PARAM1", "PARAM2", "PARAM3",
    )  # fmt: skip
    rows = [Stated(f"RC_MAP_{use}", 0, "Channel of the radio control; 0: none", 0, 18) for use in uses]
    rows += [
        Stated(f"COM_FLTMODE{place}", -1, "Mode at this position of the mode switch; -1: none", -1, 15)
        for place in range(1, 7)
    ]
    return rows


_REST = (
    Stated("BAT1_SOURCE", 0, "Source of the battery's values", -1, 2),
    Stated("BAT1_V_LOAD_DROP", 0.1, "Cell voltage drop at full throttle", 0.07, 0.5, "V", is_integer=False),
    Stated("CA_AIRFRAME", 0, "Geometry of the motors; 0: multirotor", 0, 14),
    Stated("CA_ROTOR_COUNT", 4, "Number of rotors", 0, 16, read_only=True),
    Stated("CBRK_BUZZER", 0, "Circuit breaker of the buzzer", 0, 782_097),
    Stated("CBRK_IO_SAFETY", 22_027, "Circuit breaker of the safety switch", 0, 22_027),
    Stated("CBRK_SUPPLY_CHK", 894_281, "Circuit breaker of the power supply check", 0, 894_281),
    Stated("CBRK_USB_CHK", 197_848, "Circuit breaker of the USB check", 0, 197_848),
    Stated("COM_ARM_WO_GPS", 1, "Arming without a GPS position", 0, 2),
    Stated("COM_CPU_MAX", -1.0, "CPU load above which arming is denied", -1.0, 100.0, "%", is_integer=False),
    Stated("COM_DISARM_MAN", 1, "Disarming in flight in manual thrust modes", 0, 1),
    Stated("COM_FLT_TIME_MAX", -1, "Largest flight time; -1: no limit", -1, 2**24, "s"),
    Stated("COM_HOME_EN", 1, "Home is set automatically", 0, 1),
    Stated("COM_KILL_DISARM", 5.0, "Delay of disarming by kill switch", 0.0, 30.0, "s", is_integer=False),
    Stated("COM_POSCTL_NAVL", 0, "Fallback of Position mode without a position", 0, 1),
    Stated("COM_PREARM_MODE", 0, "Condition for moving actuators before arming", 0, 2),
    Stated("COM_RC_ARM_HYST", 1_000, "Duration of the arming gesture", 100, 1_500, "ms"),
    Stated("COM_RC_IN_MODE", 1, "Source of stick input; here always a ground station", 0, 8),
    Stated("CP_DIST", -1.0, "Distance to obstacles; negative: off", -1.0, 15.0, "m", is_integer=False),
    Stated("EKF2_BARO_CTRL", 1, "Use of the barometer", 0, 1),
    Stated("EKF2_EN", 1, "Use of the estimator", 0, 1),
    Stated("EKF2_GPS_CTRL", 7, "Use of the GPS", 0, 15),
    Stated("EKF2_HGT_REF", 1, "Height reference", 0, 3),
    Stated("EKF2_IMU_CTRL", 7, "Use of the inertial sensors", 0, 7),
    Stated("EKF2_MAG_TYPE", 0, "Use of the magnetometer", 0, 6),
    Stated("GF_SOURCE", 0, "Position source of the geofence", 0, 1),
    Stated("IMU_GYRO_CUTOFF", 40.0, "Gyroscope low-pass cutoff", 0.0, 1_000.0, "Hz", is_integer=False),
    Stated("IMU_GYRO_RATEMAX", 400, "Largest rate of the rate controller", 100, 2_000, "Hz"),
    Stated("IMU_INTEG_RATE", 250, "Rate of the inertial samples", 100, 1_000, "Hz"),
    Stated("MAN_ARM_GESTURE", 1, "Arming by the sticks", 0, 1),
    Stated("MAV_COMP_ID", 1, "Component number in MAVLink", 1, 250, read_only=True),
    Stated("MAV_FWDEXTSP", 1, "Setpoints from external systems are forwarded", 0, 1),
    Stated("MAV_HASH_CHK_EN", 1, "Parameter lists begin with _HASH_CHECK", 0, 1),
    Stated("MAV_HB_FORW_EN", 1, "Heartbeats are forwarded", 0, 1),
    Stated("MAV_PROTO_VER", 2, "MAVLink version of sent messages", 2, 2, read_only=True),
    Stated("MAV_RADIO_TOUT", 5, "Timeout of a telemetry radio", 1, 250, "s"),
    Stated("MAV_SYS_ID", 1, "System number in MAVLink", 1, 255, read_only=True),
    Stated("MAV_TYPE", 2, "Kind of vehicle; 2: quadrotor", 0, 43, read_only=True),
    Stated("MAV_USEHILGPS", 0, "HIL_GPS messages from a station are used", 0, 1),
    Stated("MC_AIRMODE", 0, "Attitude control at zero thrust", 0, 2),
    Stated("MIS_TKO_LAND_REQ", 0, "Whether missions require a take-off or landing", 0, 6),
    Stated("MNT_MODE_IN", -1, "Source of gimbal setpoints; -1: no gimbal", -1, 4),
    Stated("MPC_POS_MODE", 4, "Response to the sticks in Position mode", 0, 4),
    Stated("MPC_USE_HTE", 1, "Hover thrust is estimated", 0, 1),
    Stated("RC_CHAN_CNT", 0, "Channels of the radio control", 0, 18),
    Stated("RTL_LOITER_RAD", 80.0, "Loiter radius of Return", 25.0, 1_000.0, "m", is_integer=False),
    Stated("RTL_PLD_MD", 0, "Precision landing after Return", 0, 2),
    Stated("RTL_TYPE", 0, "Destination of Return; 0: home or the nearest rally point", 0, 0),
    Stated("SDLOG_DIRS_MAX", 7, "Largest number of log folders", 0, 1_000),
    Stated("SDLOG_MISSION", 0, "Log of missions", 0, 2),
    Stated("SDLOG_MODE", 0, "When a log is written; here from a ground station's first message on", -1, 4),
    Stated("SDLOG_PROFILE", 1, "Topics of a log", 0, 4_095),
    Stated("SDLOG_UTC_OFFSET", 0, "Offset of the log's times", -1_000, 1_000, "min"),
    Stated("SENS_BOARD_ROT", 0, "Rotation of the board", -1, 40),
    Stated("SENS_DPRES_OFF", 0.001, "Offset of the airspeed sensor", -1e6, 1e6, "Pa", is_integer=False),
    Stated("SYS_AUTOCONFIG", 0, "Parameters are reset at the next start", 0, 2),
    Stated("SYS_AUTOSTART", 10_016, "Airframe; 10016: the simulated Iris; 0: another", 0, 9_999_999),
    Stated("SYS_CAL_ACCEL", 0, "Accelerometers are calibrated at the next start", 0, 2),
    Stated("SYS_CAL_GYRO", 0, "Gyroscopes are calibrated at the next start", 0, 1),
    Stated("SYS_FAILURE_EN", 0, "Failures may be injected by command", 0, 1),
    Stated("SYS_HAS_BARO", 1, "There is a barometer", 0, 1),
    Stated("SYS_HAS_GPS", 1, "There is a GPS receiver", 0, 1),
    Stated("SYS_HAS_MAG", 1, "Number of magnetometers", 0, 1),
    Stated("SYS_HAS_NUM_ASPD", 0, "Number of airspeed sensors", 0, 1),
    Stated("SYS_HITL", 0, "Hardware in the loop", -1, 2),
    Stated("SYS_PARAM_VER", 1, "Version of the parameters", 0, 2**24),
    Stated("TRIG_MODE", 0, "Trigger of a camera", 0, 4),
    Stated("UAVCAN_ENABLE", 0, "Use of a CAN bus", 0, 3),
)

STATED = tuple(sorted((*_sensors(), *_remote_control(), *_REST)))
"""Sorted by name."""
STATED_OF = {row.name: row for row in STATED}

"""The simulator's side of PX4's simulator API.

Sensor readings to MAVLink bytes, a vehicle's bytes to messages.

Pure: sockets are `harness.lockstep`'s. Units on the wire are those that PX4 decodes (facts of HIL_SENSOR,
HIL_GPS): gauss, hPa, degC; degE7, mm, cm/s; eph and epv in cm.
"""

import math

from pymavlink.dialects.v20 import common as mavlink

from autopilot.estimation.atmosphere import altitude_m
from autopilot.mavlink.codec import Message
from harness.sensors.suite import BaroSamples, GpsFixes, SensorFrame

SIMULATOR_SYSTEM_ID = 0
SIMULATOR_COMPONENT_ID = 1
_IMU = 0x3F
_MAG = 0x1C0
_BARO = 0x1A00
"""Absolute pressure, pressure altitude and temperature."""
_COURSE_UNKNOWN = 65_535
_COURSE_LEAST_SPEED_M_S = 0.1
_SATELLITES = 10


class SensorEncoder:
    """Bytes that one vehicle gets in one step."""

    def __init__(self) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=SIMULATOR_SYSTEM_ID, srcComponent=SIMULATOR_COMPONENT_ID)

    def encode(self, vehicle: int, time_us: int, frame: SensorFrame) -> bytes:
        """HIL_GPS when a fix is due, then HIL_SENSOR, which is what lets the vehicle's clock go on."""
        gps = b"" if frame.gps is None else _gps(vehicle, time_us, frame.gps).pack(self._mav)
        return bytes(gps + _sensor(vehicle, time_us, frame).pack(self._mav))


def _sensor(vehicle: int, time_us: int, frame: SensorFrame) -> Message:
    accel = frame.accel_frd_m_s2[vehicle].tolist()
    gyro = frame.gyro_frd_rad_s[vehicle].tolist()
    fields = _IMU
    mag = [0.0, 0.0, 0.0]
    if frame.mag_frd_gauss is not None:
        fields |= _MAG
        mag = frame.mag_frd_gauss[vehicle].tolist()
    baro = (0.0, 0.0, 0.0, 0.0)
    if frame.baro is not None:
        fields |= _BARO
        baro = _baro(vehicle, frame.baro)
    return mavlink.MAVLink_hil_sensor_message(time_us, *accel, *gyro, *mag, *baro, fields, 0)


def _baro(vehicle: int, baro: BaroSamples) -> tuple[float, float, float, float]:
    """Absolute and differential pressure, pressure altitude, temperature."""
    pressure_hpa = float(baro.pressure_hpa[vehicle])
    return pressure_hpa, 0.0, float(altitude_m(pressure_hpa * 100.0)), float(baro.temperature_degc[vehicle])


def _gps(vehicle: int, time_us: int, fixes: GpsFixes) -> Message:
    north, east, down = fixes.vel_ned_m_s[vehicle].tolist()
    speed_m_s = math.hypot(north, east)
    course_cdeg = round(math.degrees(math.atan2(east, north)) * 100) % 36_000
    return mavlink.MAVLink_hil_gps_message(
        time_us,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        round(fixes.lat_deg[vehicle] * 1e7),
        round(fixes.lon_deg[vehicle] * 1e7),
        round(fixes.alt_m[vehicle] * 1e3),
        _u16(fixes.eph_m * 100),
        _u16(fixes.epv_m * 100),
        _u16(speed_m_s * 100),
        round(north * 100),
        round(east * 100),
        round(down * 100),
        course_cdeg if speed_m_s > _COURSE_LEAST_SPEED_M_S else _COURSE_UNKNOWN,
        _SATELLITES,
    )


def controls(message: Message, rotors: int) -> tuple[list[float], bool]:
    """Rotor commands in 0..1 of HIL_ACTUATOR_CONTROLS, and whether it says armed.

    A NaN is a rotor at rest.
    """
    values = [min(max(value, 0.0), 1.0) if value == value else 0.0 for value in message.controls[:rotors]]
    return values, bool(message.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def _u16(value: float) -> int:
    return min(max(round(value), 0), 65_535)

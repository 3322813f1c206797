"""Telemetry of the sensors and the sticks."""

import math

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.fields import I16, UNKNOWN_U16, Part, whole
from autopilot.services.flight_data import FlightData
from autopilot.services.manual_control import ManualControlService
from autopilot.services.streams import Builder

GRAVITY_M_S2 = 9.80665
_CHANNELS = 18
"""Capacity of RC_CHANNELS."""
_RSSI_UNKNOWN = 255
SILENT = (common.MAVLINK_MSG_ID_WIND_COV,)
"""Streams that can be requested but are never sent, as in PX4: no wind estimate."""
_VIBRATION_WEIGHT = 0.01
"""Weight of the newest sample in the low-pass of PX4's vibration metrics."""


class Sensors(Part):
    """Messages of the sensors' last samples, as received."""

    def __init__(self, flight: FlightData, *, manual: ManualControlService) -> None:
        super().__init__(flight)
        self._manual = manual
        self._vibration = Vibration()

    def make_builders(self) -> dict[int, Builder]:
        """Return the builders by message id."""
        return super().make_builders() | dict.fromkeys(SILENT, lambda: None)

    def gps_raw_int(self) -> Message | None:
        """GPS_RAW_INT: the last fix as received, stamped with its arrival by the vehicle's clock.

        HIL_GPS has no ellipsoidal height; the height above sea level is sent instead, as in PX4.
        """
        gps = self._flight.gps
        if gps is None:
            return None
        return common.MAVLink_gps_raw_int_message(
            self._flight.gps_us, gps.fix_type, gps.lat, gps.lon, gps.alt, gps.eph, gps.epv, gps.vel, gps.cog,
            gps.satellites_visible, alt_ellipsoid=gps.alt, h_acc=_mm(gps.eph), v_acc=_mm(gps.epv),
        )  # fmt: skip

    def highres_imu(self) -> Message | None:
        """HIGHRES_IMU: the last sensor sample as received."""
        s = self._flight.sensor
        if s is None:
            return None
        return common.MAVLink_highres_imu_message(
            s.time_usec, s.xacc, s.yacc, s.zacc, s.xgyro, s.ygyro, s.zgyro, s.xmag, s.ymag, s.zmag,
            s.abs_pressure, s.diff_pressure, s.pressure_alt, s.temperature, s.fields_updated & 0xFFFF,
        )  # fmt: skip

    def scaled_pressure(self) -> Message | None:
        """SCALED_PRESSURE."""
        s = self._flight.baro
        if s is None:
            return None
        return common.MAVLink_scaled_pressure_message(
            self.boot_ms(), s.abs_pressure, s.diff_pressure, whole(100.0 * s.temperature, I16)
        )

    def scaled_imu(self) -> Message | None:
        """SCALED_IMU: the same in mG, mrad/s and mgauss."""
        s = self._flight.sensor
        if s is None:
            return None
        return common.MAVLink_scaled_imu_message(
            self.boot_ms(),
            *(whole(1e3 * acc / GRAVITY_M_S2, I16) for acc in (s.xacc, s.yacc, s.zacc)),
            *(whole(1e3 * rate, I16) for rate in (s.xgyro, s.ygyro, s.zgyro)),
            *(whole(1e3 * field, I16) for field in (s.xmag, s.ymag, s.zmag)),
            whole(1e2 * s.temperature, I16),
        )

    def on_sample(self) -> None:
        """Update the vibration metrics by the last inertial sample; call every step while links are up."""
        if self._flight.sensor is not None:
            self._vibration.update(self._flight.sensor)

    def vibration(self) -> Message:
        """VIBRATION as in PX4: coning, then high-frequency parts of body rates and acceleration."""
        v = self._vibration
        return common.MAVLink_vibration_message(self._flight.now_us, v.coning, v.gyro, v.accel, 0, 0, 0)

    def rc_channels(self) -> Message | None:
        """RC_CHANNELS: roll, pitch, throttle and yaw as pulse widths; None before the first sticks."""
        sticks = self._manual.sticks
        if sticks is None:
            return None
        full = (sticks.roll, sticks.pitch, 2.0 * sticks.throttle - 1.0, sticks.yaw)
        widths_us = [whole(1500.0 + 500.0 * value, (1000, 2000)) for value in full]
        unused = [UNKNOWN_U16] * (_CHANNELS - len(widths_us))
        return common.MAVLink_rc_channels_message(
            self.boot_ms(), len(widths_us), *widths_us, *unused, _RSSI_UNKNOWN
        )

    def distance_sensor(self) -> list[Message] | None:
        """DISTANCE_SENSOR: the last reading of each range finder, as received."""
        return list(self._flight.distances.values()) or None

    def hil_state_quaternion(self) -> Message | None:
        """HIL_STATE_QUATERNION: the true state, if the simulator sends it."""
        return self._flight.truth


class Vibration:
    """PX4's vibration metrics: low-passed norms of differences between successive samples."""

    def __init__(self) -> None:
        self.accel = 0.0
        """Metric of the specific force, m/s^2."""
        self.gyro = 0.0
        """Metric of the body rates, rad/s."""
        self.coning = 0.0
        """Metric of the cross product of two successive rotation increments, rad^2."""
        self._before: tuple[int, tuple[float, float, float], tuple[float, float, float]] | None = None

    def update(self, sample: Message) -> None:
        """Process a HIL_SENSOR."""
        accel, gyro = (sample.xacc, sample.yacc, sample.zacc), (sample.xgyro, sample.ygyro, sample.zgyro)
        before, self._before = self._before, (sample.time_usec, accel, gyro)
        if before is None:
            return
        dt_s = 1e-6 * (sample.time_usec - before[0])
        (p, q, r), (p0, q0, r0) = gyro, before[2]
        cross = (q * r0 - r * q0, r * p0 - p * r0, p * q0 - q * p0)
        self.accel += _VIBRATION_WEIGHT * (math.dist(accel, before[1]) - self.accel)
        self.gyro += _VIBRATION_WEIGHT * (math.dist(gyro, before[2]) - self.gyro)
        self.coning += _VIBRATION_WEIGHT * (dt_s * dt_s * math.hypot(*cross) - self.coning)


def _mm(accuracy_cm: int) -> int:
    return 0 if accuracy_cm == UNKNOWN_U16 else 10 * accuracy_cm

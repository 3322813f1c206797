"""Converts a simulator's HIL messages for the estimator, and monitors the age of each sensor's data.

A group of HIL_SENSOR is used only if all its bits of ``fields_updated`` are set, as in PX4. As there,
magnetometer and barometer are passed to the estimator at a lower rate than they are sampled.
"""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.estimation.clock import LONG_AGO_US, Clock
from autopilot.estimation.estimator import Estimator
from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil_schema import ESC_STATUS, HIL_GPS, HIL_SENSOR
from foundation.types import GpsFix, ImuSample

IMU_FIELDS = 0b11_1111
MAG_FIELDS = 0b1_1100_0000
BARO_FIELDS = 0x1A00
"""Absolute pressure, pressure altitude and temperature."""

# plain integers: as keys, members of an enumeration would need a function call each
_IMU, _BARO, _MAG, _GPS = map(int, (Condition.IMU, Condition.BARO, Condition.MAG, Condition.GPS))
TIMEOUTS_US = {_IMU: 100_000, _BARO: 1_000_000, _MAG: 1_000_000, _GPS: 2_000_000}
"""Age at which a sensor counts as lost: several periods of the slowest rate that PX4 accepts."""

_SENSOR_ID, _GPS_ID, _ESC_ID = HIL_SENSOR.message_id, HIL_GPS.message_id, ESC_STATUS.message_id
_OTHERS = frozenset({
    common.MAVLINK_MSG_ID_DISTANCE_SENSOR, common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
    common.MAVLINK_MSG_ID_HIL_OPTICAL_FLOW, common.MAVLINK_MSG_ID_LANDING_TARGET,
})  # fmt: skip
"""Messages of the scenario's own sensors."""
_US_PER_S = 1_000_000
_UNKNOWN = 65_535


class SensorsParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rates at which samples are passed to the estimator."""

    mag_rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 25.0
    """SENS_MAG_RATE: greatest rate of magnetometer samples, not averaged (PX4: 15, averaged)"""
    baro_rate_hz: Annotated[float, Meta(ge=1.0, le=200.0)] = 25.0
    """SENS_BARO_RATE: greatest rate of barometer samples, not averaged (PX4: 20, averaged)"""


class SensorInput:
    """Passes messages to the estimator and stores the last ones for telemetry."""

    def __init__(self, estimator: Estimator, params: SensorsParams, clock: Clock, *, rotors: int = 4) -> None:
        """``clock`` is that of the vehicle; this object writes its ``inertial_us``."""
        self.sensor: Message | None = None
        """The last HIL_SENSOR of sensor 0."""
        self.baro: Message | None = None
        """The last one with a pressure."""
        self.mag: Message | None = None
        """The last one with a magnetic field that the estimator uses."""
        self.gps: Message | None = None
        self.gps_us = 0
        self.motor_currents_a: Sequence[float] | None = None
        """(rotors,) of the last ESC_STATUS of all motors; None before the first."""
        self.motor_currents_us = 0
        self._rotors = rotors
        self.others: list[Message] = []
        """Messages of sensors of the last step that the estimator does not use."""
        self._currents_a: list[float] = []
        """Of the first motors, until all have arrived."""
        self._estimator = estimator
        self._clock = clock
        self._seen_us = dict.fromkeys((_BARO, _MAG, _GPS), LONG_AGO_US)
        self._mag_us = self._baro_us = 0
        """Earliest times of the next samples: multiples of the periods, so that both occur in one step."""
        self.next_aiding_us = 0
        """The earlier of the two; magnetometer and barometer readings before it are skipped."""
        self.set_params(params)

    def set_params(self, params: SensorsParams) -> None:
        """Change the rates, in effect from the next sample."""
        self._mag_period_us = round(_US_PER_S / params.mag_rate_hz)
        self._baro_period_us = round(_US_PER_S / params.baro_rate_hz)

    def take(self, messages: Sequence[Message], now_us: int) -> bool:
        """Pass one step's messages to the estimator, in order; return whether they include a GPS fix.

        `others` are then the messages of other sensors.
        """
        new_fix = False
        if self.others:
            self.others = []
        for message in messages:
            kind = message.get_msgId()
            if kind == _SENSOR_ID:
                if message.id == 0:
                    self._take_sensor(message, now_us)
            elif kind == _GPS_ID:
                self._take_gps(message, now_us)
                new_fix = True
            elif kind == _ESC_ID:
                self._take_currents(message, now_us)
            elif kind in _OTHERS:
                self.others.append(message)
        return new_fix

    def conditions(self, now_us: int) -> int:
        """Return the `Condition` bits of the sensors whose data are fresh."""
        bits = _IMU if now_us - self._clock.inertial_us <= TIMEOUTS_US[_IMU] else 0
        for condition, seen_us in self._seen_us.items():
            if now_us - seen_us <= TIMEOUTS_US[condition]:
                bits |= condition
        return bits

    def _take_currents(self, message: Message, now_us: int) -> None:
        """Store the currents of four motors; those of all are complete with the last ones."""
        first = message.index
        if first > len(self._currents_a):
            return  # an earlier message is missing
        self._currents_a = [*self._currents_a[:first], *message.current]
        if len(self._currents_a) >= self._rotors:
            self.motor_currents_a, self.motor_currents_us = self._currents_a[: self._rotors], now_us
            self._currents_a = []

    def _take_sensor(self, message: Message, now_us: int) -> None:
        self.sensor = message
        fields = message.fields_updated
        # aiding first: the inertial sample completes the estimator's step
        if fields & MAG_FIELDS == MAG_FIELDS and now_us >= self._mag_us:
            self._seen_us[_MAG] = now_us
            self.mag = message
            self._mag_us = now_us - now_us % self._mag_period_us + self._mag_period_us
            self._estimator.on_mag(now_us, (message.xmag, message.ymag, message.zmag))
        if fields & BARO_FIELDS == BARO_FIELDS:
            self.baro = message
            if now_us >= self._baro_us:
                self._seen_us[_BARO] = now_us
                self._baro_us = now_us - now_us % self._baro_period_us + self._baro_period_us
                self._estimator.on_baro(now_us, message.abs_pressure, message.temperature)
        self.next_aiding_us = min(self._mag_us, self._baro_us)
        if fields & IMU_FIELDS == IMU_FIELDS:
            self._clock.inertial_us = now_us
            self._estimator.on_imu(
                ImuSample(
                    time_us=now_us,
                    accel_frd_m_s2=(message.xacc, message.yacc, message.zacc),
                    gyro_frd_rad_s=(message.xgyro, message.ygyro, message.zgyro),
                )
            )

    def _take_gps(self, message: Message, now_us: int) -> None:
        self.gps, self.gps_us = message, now_us
        if message.fix_type >= common.GPS_FIX_TYPE_3D_FIX:
            self._seen_us[_GPS] = now_us
        self._estimator.on_gps(
            GpsFix(
                time_us=now_us,
                fix_type=message.fix_type,
                lat_deg=message.lat * 1e-7,
                lon_deg=message.lon * 1e-7,
                alt_m=message.alt * 1e-3,
                vel_ned_m_s=np.array((message.vn, message.ve, message.vd)) * 1e-2,
                eph_m=_metres(message.eph),
                epv_m=_metres(message.epv),
                satellites=message.satellites_visible,
            )
        )


def _metres(accuracy_cm: int) -> float:
    return math.inf if accuracy_cm == _UNKNOWN else accuracy_cm * 1e-2

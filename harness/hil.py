"""The simulator's side of PX4's simulator API.

Sensor readings to MAVLink bytes, and what a vehicle's answer says.

Pure: sockets are `harness.lockstep`'s. Units on the wire are those that PX4 decodes (facts of HIL_SENSOR,
HIL_GPS): gauss, hPa, degC; degE7, mm, cm/s; eph and epv in cm. Integers saturate.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import repeat

from pymavlink.dialects.v20 import common as mavlink

from autopilot.config import Site
from autopilot.estimation.atmosphere import altitude_m
from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilSensor, pack
from autopilot.navigation.geodesy import ned_to_geodetic
from harness.esc import EscReadings, pack_escs
from harness.physics.truth import Truth
from harness.sensors.suite import BaroSamples, GpsFixes, SensorFrame
from netsim.wire.lockstep import BATCH_DELIVERED

SIMULATOR_SYSTEM_ID = 0
SIMULATOR_COMPONENT_ID = 1
_IMU = 0x3F
_MAG = 0x1C0
_BARO = 0x1A00
"""Absolute pressure, pressure altitude and temperature."""
_UNKNOWN = 65_535
_COURSE_LEAST_SPEED_M_S = 0.1
_SATELLITES = 10
_NO_FIELD = (0.0, 0.0, 0.0)
_NO_AIR = (0.0, 0.0, 0.0, 0.0)
_SITE = Site()
TRUTH_PERIOD_US = 20_000
"""Between two HIL_STATE_QUATERNION, where the truth is told."""
RC_PERIOD_US = 100_000
"""Between two RC_CHANNELS, where a radio control is asked for."""
_RC_CENTRE_US = 1_500
_RC_STICKS = 4
_RC_CHANNELS = 18
_RC_UNUSED = 65_535
_RC_STRENGTH = 254
_US_PER_MS = 1_000


class SensorEncoder:
    """Bytes that the vehicles get in one step. The same kinds go to all, so their links count alike.

    But ``px4``, the vehicles that a PX4 flies, get no ESC_STATUS, which it does not know, and find it missing
    in the count if others get it. It takes the time of HIL_GPS for UTC, and ``epoch_us`` is the simulation's
    beginning. ``px4_rc`` has it told of a radio control.
    """

    def __init__(
        self, site: Site = _SITE, *, px4: Collection[int] = (), epoch_us: int = 0, px4_rc: bool = False
    ) -> None:
        self._site = site
        self._px4 = frozenset(px4)
        self._epoch_us = epoch_us
        self._px4_rc = px4_rc
        self._mav = mavlink.MAVLink(None, srcSystem=SIMULATOR_SYSTEM_ID, srcComponent=SIMULATOR_COMPONENT_ID)
        self._sequence = 0

    def encode(
        self,
        time_us: int,
        frame: SensorFrame,
        escs: EscReadings | None = None,
        truth: Truth | None = None,
        delivered: Collection[int] = (),
    ) -> Iterator[bytes]:
        """Frames for one vehicle after the other, each made when it is asked for.

        ESC_STATUS when there are readings of motors, HIL_GPS when a fix is due, HIL_STATE_QUATERNION when
        the truth is to be told, then HIL_SENSOR, which is what lets a vehicle's clock go on. It tells those
        who are ``delivered``, by their numbers, that the radio has brought them something for this step.
        """
        told_rc = self._px4_rc and time_us % RC_PERIOD_US == 0
        rc_sequence = (self._sequence + (escs is not None)) % 256
        fix_sequence = (rc_sequence + told_rc) % 256
        state_sequence = (fix_sequence + (frame.gps is not None)) % 256
        sequence = (state_sequence + (truth is not None)) % 256
        motors: Iterable[bytes] = repeat(b"")
        if escs is not None:
            motors = pack_escs(
                time_us,
                escs,
                sequence=self._sequence,
                system=SIMULATOR_SYSTEM_ID,
                component=SIMULATOR_COMPONENT_ID,
            )
        self._sequence = (sequence + 1) % 256
        fields = _IMU
        inertial = zip(frame.accel_frd_m_s2.tolist(), frame.gyro_frd_rad_s.tolist(), strict=True)
        mag: Iterable[Sequence[float]] = repeat(_NO_FIELD)
        if frame.mag_frd_gauss is not None:
            fields |= _MAG
            mag = frame.mag_frd_gauss.tolist()
        baro: Iterable[Sequence[float]] = repeat(_NO_AIR)
        if frame.baro is not None:
            fields |= _BARO
            baro = _baro(frame.baro)
        each = zip(inertial, mag, baro, motors, strict=False)
        for vehicle, ((accel, gyro), field, air, motor) in enumerate(each):
            told = fields | BATCH_DELIVERED if vehicle in delivered else fields
            sensor = pack(
                HilSensor._make((time_us, *accel, *gyro, *field, *air, told, 0)),
                sequence=sequence,
                system=SIMULATOR_SYSTEM_ID,
                component=SIMULATOR_COMPONENT_ID,
            )
            if truth is not None:
                self._mav.seq = state_sequence
                sensor = _state(vehicle, time_us, truth, self._site).pack(self._mav) + sensor
            if frame.gps is not None:
                self._mav.seq = fix_sequence
                utc_us = time_us + self._epoch_us if vehicle in self._px4 else time_us
                sensor = _gps(vehicle, utc_us, frame.gps).pack(self._mav) + sensor
            if vehicle not in self._px4:
                sensor = motor + sensor
            elif told_rc:
                self._mav.seq = rc_sequence
                sensor = _rc(time_us).pack(self._mav) + sensor
            yield sensor


def _baro(baro: BaroSamples) -> list[tuple[float, float, float, float]]:
    """Absolute and differential pressure, pressure altitude, temperature of each vehicle."""
    pressures_hpa, temperatures_degc = baro.pressure_hpa.tolist(), baro.temperature_degc.tolist()
    return [
        (pressure_hpa, 0.0, altitude_m(pressure_hpa * 100.0), temperature_degc)
        for pressure_hpa, temperature_degc in zip(pressures_hpa, temperatures_degc, strict=True)
    ]


def _rc(time_us: int) -> Message:
    """RC_CHANNELS of a radio control that nobody touches."""
    sticks = [_RC_CENTRE_US] * _RC_STICKS
    others = [_RC_UNUSED] * (_RC_CHANNELS - _RC_STICKS)
    return mavlink.MAVLink_rc_channels_message(
        time_us // _US_PER_MS, _RC_STICKS, *sticks, *others, _RC_STRENGTH
    )


def _gps(vehicle: int, time_us: int, fixes: GpsFixes) -> Message:
    if fixes.lost is not None and fixes.lost[vehicle]:
        return mavlink.MAVLink_hil_gps_message(
            time_us, mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, _UNKNOWN, _UNKNOWN, _UNKNOWN, 0, 0, 0, _UNKNOWN, 0
        )
    north, east, down = fixes.vel_ned_m_s[vehicle].tolist()
    speed_m_s = math.hypot(north, east)
    course_cdeg = round(math.degrees(math.atan2(east, north)) * 100) % 36_000
    return mavlink.MAVLink_hil_gps_message(
        time_us,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        _i32(fixes.lat_deg[vehicle] * 1e7),
        _i32(fixes.lon_deg[vehicle] * 1e7),
        _i32(fixes.alt_m[vehicle] * 1e3),
        _u16(fixes.eph_m * 100),
        _u16(fixes.epv_m * 100),
        _u16(speed_m_s * 100),
        _i16(north * 100),
        _i16(east * 100),
        _i16(down * 100),
        course_cdeg if speed_m_s > _COURSE_LEAST_SPEED_M_S else _UNKNOWN,
        _SATELLITES,
    )


def _state(vehicle: int, time_us: int, truth: Truth, site: Site) -> Message:
    """HIL_STATE_QUATERNION; its position is good to a centimetre, as degE7 are."""
    lat_deg, lon_deg, alt_m = ned_to_geodetic(
        truth.pos_ned_m[vehicle],
        origin_lat_deg=site.latitude_deg,
        origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    )
    north, east, down = truth.vel_ned_m_s[vehicle].tolist()
    return mavlink.MAVLink_hil_state_quaternion_message(
        time_us,
        truth.q_ned_frd[vehicle].tolist(),
        *truth.omega_frd_rad_s[vehicle].tolist(),
        _i32(float(lat_deg) * 1e7),
        _i32(float(lon_deg) * 1e7),
        _i32(float(alt_m) * 1e3),
        _i16(north * 100),
        _i16(east * 100),
        _i16(down * 100),
        *(0, 0, 0, 0, 0),
    )


def is_armed(answer: HilActuatorControls) -> bool:
    """Whether a vehicle's answer says that it is armed."""
    return bool(answer.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def _u16(value: float) -> int:
    return round(min(max(value, 0.0), 65_535.0))


def _i16(value: float) -> int:
    return round(min(max(value, -32_768.0), 32_767.0))


def _i32(value: float) -> int:
    return round(min(max(value, -2_147_483_648.0), 2_147_483_647.0))

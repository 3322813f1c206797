"""The simulator's side of PX4's simulator API: encodes sensor readings as MAVLink bytes.

Answers are decoded by `harness.simulator.actuator_inbox`. No I/O: `harness.simulator.lockstep` has the
sockets. Units on the wire are those that PX4 decodes from HIL_SENSOR and HIL_GPS: gauss, hPa, degC; degE7,
mm, cm/s; eph and epv in cm. Integers saturate.
"""

import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from autopilot.estimation.atmosphere import altitude_m
from autopilot.estimation.sensor_input import BARO_FIELDS, IMU_FIELDS, MAG_FIELDS
from autopilot.mavlink.hil_schema import (
    ESC_STATUS,
    HIL_GPS,
    HIL_SENSOR,
    HIL_STATE_QUATERNION,
    RC_CHANNELS,
    MessageSchema,
)
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.types import Array
from harness.simulator.hil_frames import (
    SIMULATOR_COMPONENT_ID,
    SIMULATOR_SYSTEM_ID,
    InertialFrames,
    encode_rows,
    write_samples,
)
from harness.world.esc import EscStatus
from harness.world.physics.truth import Truth
from harness.world.sensors.extra import Arrival
from harness.world.sensors.suite import GpsFixes, SensorFrame
from netsim.wire.lockstep import BATCH_DELIVERED

_UNKNOWN = 65_535
_COURSE_LEAST_SPEED_M_S = 0.1
_SATELLITES = 10
_SITE = Site()
TRUTH_PERIOD_US = 20_000
"""Period of HIL_STATE_QUATERNION, where the truth is sent."""
RC_PERIOD_US = 100_000
"""Period of RC_CHANNELS, where a radio control is simulated."""
_RC_CENTRE_US = 1_500
_RC_STICKS, _RC_CHANNELS = 4, 18
_RC_UNUSED = 65_535
_RC_STRENGTH = 254
_US_PER_MS = 1_000


class SensorEncoder:
    """Encodes the messages to all vehicles in one step, with common sequence numbers.

    ``px4`` are the vehicles that a PX4 flies. PX4 does not support ESC_STATUS, so it is not sent to them;
    their sequence numbers have a gap if other vehicles get it. PX4 reads the time of HIL_GPS as UTC:
    ``epoch_us`` is that of the simulation's start. With ``px4_rc`` they are sent the channels of a radio
    control.
    """

    def __init__(
        self, site: Site = _SITE, *, px4: Collection[int] = (), epoch_us: int = 0, px4_rc: bool = False
    ) -> None:
        self._site = site
        self._px4 = frozenset(px4)
        self._epoch_us = epoch_us
        self._px4_rc = px4_rc
        self._sequence = 0
        self._link = mavlink.MAVLink(None, srcSystem=SIMULATOR_SYSTEM_ID, srcComponent=SIMULATOR_COMPONENT_ID)
        """Source of the messages of the scenario's own sensors."""
        self._inertial = InertialFrames(0, IMU_FIELDS)

    def encode(
        self,
        time_us: int,
        frame: SensorFrame,
        escs: Sequence[EscStatus] = (),
        truth: Truth | None = None,
        delivered: Collection[int] = (),
        arrivals: Sequence[Arrival] = (),
    ) -> Sequence[bytes | memoryview]:
        """Return the frames for each vehicle, valid until the next call.

        They are the messages of ``arrivals``, ESC_STATUS, one for each of ``escs``, HIL_GPS if a fix is due,
        HIL_STATE_QUATERNION if ``truth`` is given, and last HIL_SENSOR, which advances the vehicle's clock.
        In HIL_SENSOR the vehicles ``delivered`` are notified of a delivery by their radio in this step.
        Raises ExtensionFailure for a sensor of the user without a valid message.
        """
        own_messages = self.readings(arrivals) if arrivals else {}
        others: list[list[bytes]] = []
        for rows, absent in escs:
            others.append(self._but(self._px4 | absent, self._encode(ESC_STATUS, rows)))
        if self._px4_rc and time_us % RC_PERIOD_US == 0:
            vehicles = len(frame.accel_frd_m_s2)
            own = frozenset(range(vehicles)) - self._px4
            others.append(self._but(own, self._encode(RC_CHANNELS, _rc(time_us, vehicles))))
        if frame.gps is not None:
            others.append(self._encode(HIL_GPS, self._fixes(time_us, frame.gps)))
        if truth is not None:
            others.append(self._encode(HIL_STATE_QUATERNION, _states(time_us, truth, self._site)))
        sensors = self._sensors(time_us, frame, delivered)
        if others:
            sensors = [b"".join(parts) for parts in zip(*others, sensors, strict=True)]
        if own_messages:
            sensors = [own_messages.get(vehicle, b"") + bytes(each) for vehicle, each in enumerate(sensors)]
        return sensors

    def readings(self, arrivals: Sequence[Arrival]) -> dict[int, bytes]:
        """Return the frames of readings by vehicle."""
        frames: dict[int, bytes] = {}
        for sensor, reading in arrivals:
            self._link.seq = self._next()
            frames[sensor.vehicle] = frames.get(sensor.vehicle, b"") + sensor.frame(reading, self._link)
        return frames

    def _sensors(
        self, time_us: int, frame: SensorFrame, delivered: Collection[int]
    ) -> Sequence[bytes | memoryview]:
        """Return the frames of HIL_SENSOR."""
        if frame.mag_frd_gauss is not None or frame.baro is not None or delivered:
            return self._encode(HIL_SENSOR, _sensors(time_us, frame, delivered))
        accel_frd_m_s2, gyro_frd_rad_s = frame.accel_frd_m_s2, frame.gyro_frd_rad_s
        if self._inertial.vehicles != len(accel_frd_m_s2):
            self._inertial = InertialFrames(len(accel_frd_m_s2), IMU_FIELDS)
        return self._inertial.at(time_us, accel_frd_m_s2, gyro_frd_rad_s, self._next())

    def _encode(self, schema: MessageSchema, rows: NDArray[np.void]) -> list[bytes]:
        """Return the frames of rows (n,)."""
        return encode_rows(schema, rows, self._next())

    def _next(self) -> int:
        """Return the next sequence number, one per kind of frame."""
        sequence = self._sequence
        self._sequence = (sequence + 1) % 256
        return sequence

    @staticmethod
    def _but(without: Collection[int], frames: list[bytes]) -> list[bytes]:
        """Replace the frames of the vehicles in ``without`` by empty ones."""
        return [b"" if vehicle in without else each for vehicle, each in enumerate(frames)]

    def _fixes(self, time_us: int, fixes: GpsFixes) -> NDArray[np.void]:
        """Return HIL_GPS of each vehicle, (n,)."""
        rows = np.zeros(len(fixes.lat_deg), HIL_GPS.dtype)
        rows["fix_type"] = mavlink.GPS_FIX_TYPE_3D_FIX
        rows["lat"] = _integers(fixes.lat_deg * 1e7, np.int32)
        rows["lon"] = _integers(fixes.lon_deg * 1e7, np.int32)
        rows["alt"] = _integers(fixes.alt_m * 1e3, np.int32)
        rows["eph"] = _integers(fixes.eph_m * 100, np.uint16)
        rows["epv"] = _integers(fixes.epv_m * 100, np.uint16)
        north_east_m_s: list[list[float]] = fixes.vel_ned_m_s[:, :2].tolist()
        speeds_m_s = np.array([math.hypot(north, east) for north, east in north_east_m_s])
        courses_deg = np.array([math.degrees(math.atan2(east, north)) for north, east in north_east_m_s])
        rows["vel"] = _integers(speeds_m_s * 100, np.uint16)
        rows["vn"], rows["ve"], rows["vd"] = _integers(fixes.vel_ned_m_s.T * 100, np.int16)
        courses_cdeg = np.rint(courses_deg * 100) % 36_000
        rows["cog"] = np.where(speeds_m_s > _COURSE_LEAST_SPEED_M_S, courses_cdeg, _UNKNOWN)
        rows["satellites_visible"] = _SATELLITES
        if fixes.lost is not None:
            rows[fixes.lost] = _NO_FIX
        rows["time_usec"] = time_us
        for vehicle in self._px4:
            rows["time_usec"][vehicle] += self._epoch_us
        return rows


def _sensors(time_us: int, frame: SensorFrame, delivered: Collection[int]) -> NDArray[np.void]:
    """Return HIL_SENSOR of each vehicle, (n,)."""
    vehicles = len(frame.accel_frd_m_s2)
    rows = np.zeros(vehicles, HIL_SENSOR.dtype)
    fields, mag_frd_gauss = IMU_FIELDS, frame.mag_frd_gauss
    if mag_frd_gauss is None:
        mag_frd_gauss = np.zeros((vehicles, 3))
    else:
        fields |= MAG_FIELDS
    if frame.baro is None:
        pressure_hpa = temperature_degc = np.zeros(vehicles)
    else:
        fields |= BARO_FIELDS
        pressure_hpa, temperature_degc = frame.baro
    fill_sensors(
        rows, time_us, fields, frame.accel_frd_m_s2, frame.gyro_frd_rad_s, mag_frd_gauss, pressure_hpa,
        temperature_degc,
    )  # fmt: skip
    for vehicle in delivered:
        rows["fields_updated"][vehicle] |= BATCH_DELIVERED
    return rows


@njit(cache=True)
def fill_sensors(
    rows: NDArray[np.void],
    time_us: int,
    fields_updated: int,
    accel_frd_m_s2: Array,
    gyro_frd_rad_s: Array,
    mag_frd_gauss: Array,
    pressure_hpa: Array,
    temperature_degc: Array,
) -> None:
    """Fill zeroed rows (n,) of HIL_SENSOR with the readings that ``fields_updated`` marks as new."""
    for i in range(len(rows)):
        row = rows[i]
        row["time_usec"] = time_us
        row["fields_updated"] = fields_updated
        write_samples(row, accel_frd_m_s2[i], gyro_frd_rad_s[i])
        row["xmag"], row["ymag"], row["zmag"] = mag_frd_gauss[i, 0], mag_frd_gauss[i, 1], mag_frd_gauss[i, 2]
        if fields_updated & BARO_FIELDS:
            row["abs_pressure"] = pressure_hpa[i]
            row["pressure_alt"] = altitude_m(pressure_hpa[i] * 100.0)
            row["temperature"] = temperature_degc[i]


def _no_fix() -> NDArray[np.void]:
    """Return HIL_GPS (1,) of a receiver without a fix; its time is not set."""
    row = np.zeros(1, HIL_GPS.dtype)
    row["fix_type"] = mavlink.GPS_FIX_TYPE_NO_FIX
    for name in ("eph", "epv", "vel", "cog"):
        row[name] = _UNKNOWN
    return row


_NO_FIX = _no_fix()


def _rc(time_us: int, vehicles: int) -> NDArray[np.void]:
    """Return RC_CHANNELS (n,) of radio controls with centred sticks."""
    rows = np.zeros(vehicles, RC_CHANNELS.dtype)
    rows["time_boot_ms"] = time_us // _US_PER_MS
    for number in range(1, _RC_CHANNELS + 1):
        rows[f"chan{number}_raw"] = _RC_CENTRE_US if number <= _RC_STICKS else _RC_UNUSED
    rows["chancount"] = _RC_STICKS
    rows["rssi"] = _RC_STRENGTH
    return rows


def _states(time_us: int, truth: Truth, site: Site) -> NDArray[np.void]:
    """Return HIL_STATE_QUATERNION of each vehicle, (n,); degE7 resolve its position to a centimetre."""
    lat_deg, lon_deg, alt_m = ned_to_geodetic(
        truth.pos_ned_m,
        origin_lat_deg=site.latitude_deg,
        origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    )
    rows = np.zeros(len(truth.pos_ned_m), HIL_STATE_QUATERNION.dtype)
    rows["time_usec"] = time_us
    rows["attitude_quaternion"] = truth.q_ned_frd
    rows["rollspeed"], rows["pitchspeed"], rows["yawspeed"] = truth.omega_frd_rad_s.T
    rows["lat"] = _integers(lat_deg * 1e7, np.int32)
    rows["lon"] = _integers(lon_deg * 1e7, np.int32)
    rows["alt"] = _integers(alt_m * 1e3, np.int32)
    rows["vx"], rows["vy"], rows["vz"] = _integers(truth.vel_ned_m_s.T * 100, np.int16)
    return rows


def _integers(values: Array | float, kind: type[np.integer[Any]]) -> Array:
    """Round to the nearest whole numbers within the range of an integer type."""
    limits = np.iinfo(kind)
    return np.asarray(np.rint(np.clip(values, limits.min, limits.max)))

"""A log of a vehicle's estimates, setpoints and status in PX4's ULog format, version 1.

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html. A header, definitions (flag bits, formats,
information, parameters), then data: subscriptions, samples, changed parameters, texts. Pure: returns bytes.
Timestamps are microseconds of simulated time. Positions are from the estimator's origin, in NED, in metres.
"""

import contextlib
import math
import struct
from typing import TYPE_CHECKING, NamedTuple

from autopilot.commander.commander import Commander
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode
from autopilot.navigation.site_frame import geodetic
from autopilot.parameters.table import ROWS, ParameterSet
from autopilot.services.parameter import value_bytes
from foundation.geometry.rotations import quat_to_euler

if TYPE_CHECKING:
    from autopilot.vehicle.vehicle import Vehicle

MAGIC = b"ULog\x01\x12\x35"
VERSION = 1
_HEADER = struct.Struct("<7sBQ")
_MESSAGE = struct.Struct("<HB")
_CODES = {"uint64_t": "Q", "double": "d", "float": "f", "uint8_t": "B", "bool": "?"}
_NAN3 = (math.nan, math.nan, math.nan)
Numbers = tuple[float, ...]


class Topic(NamedTuple):
    """A topic by PX4's name, and the fields of its samples after the timestamp, in order."""

    name: str
    fields: tuple[str, ...]
    """C type and name, as in ``float[4] q``; large types first, so that no padding is needed."""

    @property
    def format(self) -> str:
        """Text of the format definition."""
        return f"{self.name}:uint64_t timestamp;" + "".join(f"{field};" for field in self.fields)

    @property
    def layout(self) -> struct.Struct:
        """Layout of a sample."""
        codes = "Q"
        for field in self.fields:
            kind, _, length = field.split(" ")[0].rstrip("]").partition("[")
            codes += length + _CODES[kind]
        return struct.Struct("<" + codes)


TOPICS = (
    Topic("vehicle_attitude", ("float[4] q",)),
    Topic(
        "vehicle_local_position",
        (
            "double ref_lat", "double ref_lon", "float ref_alt", "float x", "float y", "float z", "float vx",
            "float vy", "float vz", "float heading", "float eph", "float epv", "bool xy_valid",
            "bool z_valid", "bool v_xy_valid", "bool v_z_valid", "bool xy_global", "bool z_global",
        ),
    ),
    Topic("vehicle_local_position_setpoint", (
        "float x", "float y", "float z", "float vx", "float vy", "float vz", "float yaw",
    )),
    Topic("vehicle_global_position", (
        "double lat", "double lon", "float alt", "float eph", "float epv",
    )),
    Topic("battery_status", (
        "float voltage_v", "float current_a", "float remaining", "uint8_t warning", "bool connected",
    )),
    Topic("vehicle_status", (
        "uint64_t armed_time", "uint8_t arming_state", "uint8_t nav_state", "uint8_t vehicle_type",
        "uint8_t system_id", "bool failsafe",
    )),
)  # fmt: skip
"""Indexed by subscription id."""
_LAYOUTS = tuple(topic.layout for topic in TOPICS)

NAV_STATES = {
    FlightMode.MANUAL: 0, FlightMode.ALTITUDE: 1, FlightMode.POSITION: 2, FlightMode.MISSION: 3,
    FlightMode.HOLD: 4, FlightMode.READY: 4, FlightMode.RETURN: 5, FlightMode.ACRO: 10,
    FlightMode.DESCEND: 12, FlightMode.OFFBOARD: 14, FlightMode.STABILIZED: 15, FlightMode.TAKEOFF: 17,
    FlightMode.LAND: 18,
    **{mode: 23 + number for number, mode in enumerate(EXTERNAL_MODES)},
}  # fmt: skip
"""PX4's vehicle_status.nav_state"""
_OTHER_STATE = 21
"""Orbit, the only other mode; 21 is NAVIGATION_STATE_ORBIT."""
_STANDBY, _ARMED = 1, 2
_ROTARY_WING = 1


class UlogWriter:
    """Returns the bytes of one log, piece by piece."""

    def __init__(self, name: str, parameters: ParameterSet) -> None:
        """``name`` is the vehicle's name in the log."""
        self._name = name
        self._parameters = parameters
        self._version = -1
        self._written: dict[str, bytes] = {}
        self._armed_us: int | None = None

    def begin(self, now_us: int) -> bytes:
        """Return header and definitions."""
        data = _HEADER.pack(MAGIC, VERSION, now_us) + _message("B", bytes(40))
        for topic in TOPICS:
            data += _message("F", topic.format.encode())
        data += _information("char", "sys_name", b"coflight") + _information("char", "ver_hw", b"SIM")
        data += _information("char", "vehicle", self._name.encode())
        data += self._changed_parameters()
        for number, topic in enumerate(TOPICS):
            data += _message("A", struct.pack("<BH", 0, number) + topic.name.encode())
        return data

    def samples(self, vehicle: "Vehicle") -> bytes:
        """Return a sample of each topic that has data, and parameters that changed since the last call."""
        now_us = vehicle.flight.now_us
        commander = vehicle.commander
        if not commander.armed:
            self._armed_us = None
        elif self._armed_us is None:
            self._armed_us = now_us
        data = b"" if self._version == self._parameters.version else self._changed_parameters()
        values = (
            _attitude(vehicle),
            _local_position(vehicle),
            _setpoint(vehicle),
            _global_position(vehicle),
            _battery(vehicle),
            _status(commander, self._armed_us or 0, vehicle.config.instance + 1),
        )
        for number, (layout, sample) in enumerate(zip(_LAYOUTS, values, strict=True)):
            if sample is not None:
                with contextlib.suppress(OverflowError):  # the estimate has diverged
                    data += _message("D", struct.pack("<H", number) + layout.pack(now_us, *sample))
        return data

    @staticmethod
    def text(severity: int, now_us: int, text: str) -> bytes:
        """Return a text that was sent to the stations; ``severity`` is MAV_SEVERITY, as in syslog."""
        return _message("L", struct.pack("<BQ", ord("0") + severity, now_us) + text.encode())

    def _changed_parameters(self) -> bytes:
        self._version = self._parameters.version
        data = b""
        for row in ROWS:
            value = value_bytes(row.is_integer, self._parameters.get(row.name))
            if self._written.get(row.name) != value:
                self._written[row.name] = value
                key = f"{'int32_t' if row.is_integer else 'float'} {row.name}".encode()
                data += _message("P", bytes([len(key)]) + key + value)
        return data


def _message(kind: str, content: bytes) -> bytes:
    return _MESSAGE.pack(len(content), ord(kind)) + content


def _information(kind: str, name: str, value: bytes) -> bytes:
    key = f"{kind}[{len(value)}] {name}".encode()
    return _message("I", bytes([len(key)]) + key + value)


def _attitude(vehicle: "Vehicle") -> Numbers | None:
    state = vehicle.flight.state
    return tuple(state.q_ned_frd.tolist()) if state.attitude_valid else None


def _local_position(vehicle: "Vehicle") -> Numbers | None:
    state, known = vehicle.flight.state, vehicle.flight.origin_known
    if not state.attitude_valid:
        return None
    north_std, east_std, down_std = state.pos_std_m.tolist()
    return (
        state.origin_lat_deg if known else math.nan, state.origin_lon_deg if known else math.nan,
        state.origin_alt_m if known else math.nan, *state.pos_ned_m.tolist(), *state.vel_ned_m_s.tolist(),
        quat_to_euler(state.q_ned_frd).tolist()[2], math.hypot(north_std, east_std), down_std,
        state.position_valid, state.height_valid, state.velocity_valid, state.velocity_valid, known, known,
    )  # fmt: skip


def _setpoint(vehicle: "Vehicle") -> Numbers | None:
    setpoint = vehicle.flight.setpoint
    if setpoint is None:
        return None
    position = _NAN3 if setpoint.pos_ned_m is None else tuple(setpoint.pos_ned_m)
    velocity = _NAN3 if setpoint.vel_ned_m_s is None else tuple(setpoint.vel_ned_m_s)
    return (
        *(value if used else math.nan for value, used in zip(position, setpoint.pos_axes, strict=True)),
        *(value if used else math.nan for value, used in zip(velocity, setpoint.vel_axes, strict=True)),
        math.nan if setpoint.yaw_rad is None else setpoint.yaw_rad,
    )


def _global_position(vehicle: "Vehicle") -> Numbers | None:
    state = vehicle.flight.state
    if not (vehicle.flight.origin_known and state.position_valid):
        return None
    north_std, east_std, down_std = state.pos_std_m.tolist()
    return *geodetic(state.pos_ned_m, state), math.hypot(north_std, east_std), down_std


def _battery(vehicle: "Vehicle") -> Numbers | None:
    battery = vehicle.flight.battery
    if battery.sampled_us is None:
        return None
    current_a = -1.0 if battery.current_a is None else battery.current_a
    return battery.voltage_v, current_a, battery.remaining, int(battery.warning), True


def _status(commander: Commander, armed_us: int, system: int) -> Numbers:
    arming = _ARMED if commander.armed else _STANDBY
    nav_state = NAV_STATES.get(commander.mode, _OTHER_STATE)
    return armed_us, arming, nav_state, _ROTARY_WING, system, commander.failsafe

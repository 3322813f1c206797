"""The UAV's autopilot as its applications use it: state, commands, setpoints, parameters. No I/O.

The autopilot is coflight's own, a PX4 or an ArduPilot; what differs between them is in `autopilots`. All
applications of one UAV share one client.
"""

import math
import struct
from enum import Enum

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.autopilots import PX4, AutopilotInterface
from autopilot.onboard.client.commands import CommandSender, RepeatedCommand
from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.client.take_off import TakeOff
from autopilot.parameters.config import Site
from foundation.types import Vector

FLOWN_HEIGHT_M = 0.3
"""A vehicle disarmed after exceeding this height has landed."""
MOST = 1e9
"""Greatest number of a setpoint."""
MOST_MESSAGES = 1_000
"""Messages of one iteration; an application that sends more has failed."""
_LOCAL_NED = int(common.MAV_FRAME_LOCAL_NED)
_POS_SHIFT, _VEL_SHIFT, _ACC_SHIFT = 0, 3, 6
"""Position of the bits of the axes in `PositionTarget.type_mask`."""
_ALL_AXES = 0b111
_IGNORE_ACC = (
    common.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AZ_IGNORE
)
_IGNORE_YAW = common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_IGNORE_YAW_RATE = common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_PACKER = common.MAVLink(None)
_SETPOINT = struct.Struct("<I4H11f")
"""Fields of `PositionTarget`."""
_ZERO: Vector = (0.0, 0.0, 0.0)
Axes = tuple[float | None, float | None, float | None]
"""North, east and down; None: this axis is not given."""


class FlightState(Enum):
    """State of the flight that `AutopilotClient.take_off` began."""

    ON_GROUND = "on ground"
    """Before it."""
    ARMING = "arming"
    TAKING_OFF = "taking off"
    FOLLOWING = "following"
    """In the air; the autopilot follows setpoints unless `AutopilotClient.yielded`."""
    LANDED = "landed"
    """Disarmed after it."""


class AutopilotClient:
    """State of one UAV's autopilot, and what its applications send to it.

    Attributes:
        own: everything that the autopilot's messages contain; see `OwnState`.
        commands: the command that is repeated until the autopilot accepts it.
        flight: state of the flight that `take_off` began.
        parameters: values by name that the autopilot has reported.

    """

    def __init__(
        self, *, system: int, site: Site, gps_delay_s: float, interface: AutopilotInterface = PX4
    ) -> None:
        self.own = OwnState(site=site, gps_delay_s=gps_delay_s, autopilot=interface)
        self.commands = CommandSender(target_system=system)
        self.interface = interface
        self.flight = FlightState.ON_GROUND
        self.parameters: dict[str, float] = {}
        self._system = system
        self._take_off = TakeOff(self.commands, interface)
        self._height_m = 0.0
        self._since_us = 0
        self._has_flown = False
        self._now_us = 0
        self._outgoing: list[Message | PositionTarget] = []
        self._requested: set[str] = set()

    # ---- state

    @property
    def pos_ned_m(self) -> Vector | None:
        """Position, site NED; None: unknown.

        North and east are those of the autopilot, with the GPS error; down is from the ground of the start.
        """
        own = self.own
        return None if own.origin_ned_m is None or own.time_us < 0 else own.autopilot_ned_m

    @property
    def time_us(self) -> int:
        """Simulated time of `pos_ned_m` and `vel_ned_m_s`; -1: there is none."""
        return self.own.time_us

    @property
    def vel_ned_m_s(self) -> Vector:
        """Velocity, NED."""
        return self.own.vel_ned_m_s

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""
        return self.own.armed

    @property
    def mode(self) -> FlightMode | None:
        """The flight mode of PX4, or that of PX4 with the same purpose; None: unknown, or without one."""
        return self.own.mode

    @property
    def follows(self) -> bool:
        """Whether the vehicle follows the setpoints of `fly`."""
        return (
            self.flight is FlightState.FOLLOWING
            and self.mode is FlightMode.OFFBOARD
            and not self.own.failsafe
        )

    @property
    def landed(self) -> bool:
        """Whether the motors are disarmed after the flight that `take_off` began."""
        return self.flight is FlightState.LANDED

    # ---- requests of the application

    def take_off(self, height_m: float = 2.5) -> None:
        """Arm, take off to a height above the ground, and change to the mode that follows setpoints.

        The vehicle is armed once it has a position. Repeated calls have no effect, nor has one after landing.
        """
        if not 0.5 <= height_m <= 1_000.0:
            raise ValueError(f"height_m: {height_m}; expected 0.5 to 1000")
        if self.flight is FlightState.ON_GROUND and self.pos_ned_m is not None and self.own.fix is not None:
            self.flight, self._height_m, self._since_us = FlightState.ARMING, height_m, self._now_us

    def fly(
        self, *, pos_ned_m: Axes | None = None, vel_ned_m_s: Axes | None = None,
        acc_ned_m_s2: Axes | None = None, yaw_rad: float | None = None, yaw_rate_rad_s: float | None = None,
    ) -> None:  # fmt: skip
        """Send a setpoint: any of position (site NED, down from the ground), velocity and acceleration.

        An axis may be None, such as in ``fly(vel_ned_m_s=(2.0, 0.0, None), pos_ned_m=(None, None, -8.0))``.
        The autopilot adds a velocity to the one that a position on the same axis causes, and likewise an
        acceleration.

        To be called in every iteration, or at least twice a second: autopilots leave the mode without
        setpoints. It has no effect unless the vehicle `follows`. Raises ValueError for an axis without a
        setpoint, another size, numbers that are not finite, and beside an ArduPilot, which ignores these, for
        vectors of which only some axes are given and for position with acceleration but without velocity.
        """
        own = self.own
        (north_m, east_m, down_m), pos_axes = self._given("pos_ned_m", pos_ned_m)
        (vel_n, vel_e, vel_d), vel_axes = self._given("vel_ned_m_s", vel_ned_m_s)
        acc, acc_axes = self._given("acc_ned_m_s2", acc_ned_m_s2)
        if pos_axes | vel_axes | acc_axes != _ALL_AXES:
            raise ValueError(
                "fly: expected one of pos_ned_m, vel_ned_m_s, acc_ned_m_s2 or more for each of the three axes"
            )
        if not self.interface.mixes_axes and pos_axes and acc_axes and not vel_axes:
            raise ValueError("fly: expected a velocity between position and acceleration beside an ArduPilot")
        origin_n_m, origin_e_m, _ = own.origin_ned_m or _ZERO
        pos = (north_m - origin_n_m, east_m - origin_e_m, down_m + own.height.autopilot_down_m)
        vel = (vel_n, vel_e, vel_d + own.height.vel_error_m_s)
        given = pos_axes << _POS_SHIFT | vel_axes << _VEL_SHIFT | acc_axes << _ACC_SHIFT
        mask = given ^ (_ALL_AXES << _POS_SHIFT | _ALL_AXES << _VEL_SHIFT | _ALL_AXES << _ACC_SHIFT)
        for name, value in (("yaw_rad", yaw_rad), ("yaw_rate_rad_s", yaw_rate_rad_s)):
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name}: {value}; expected a finite number")
        if not self.follows:
            return
        mask |= _IGNORE_YAW if yaw_rad is None else 0
        mask |= _IGNORE_YAW_RATE if yaw_rate_rad_s is None else 0
        self.send(
            PositionTarget(
                self._now_us // 1_000, self._system, AUTOPILOT_COMPONENT, _LOCAL_NED, mask, *pos, *vel, *acc,
                yaw_rad or 0.0, yaw_rate_rad_s or 0.0,
            )
        )  # fmt: skip

    def land(self) -> None:
        """Land where the vehicle is; the command is repeated until it is accepted."""
        self.command(common.MAV_CMD_NAV_LAND)

    def command(self, number: int, *params: float) -> None:
        """Send a MAV_CMD with up to seven parameters (others are 0), until it is accepted.

        It replaces a command that has not been accepted yet; repeated calls have no effect.
        """
        first, second, third, fourth, fifth, sixth, seventh = (*params, *[0.0] * (7 - len(params)))
        values = (first, second, third, fourth, fifth, sixth, seventh)
        self.commands.request(RepeatedCommand(number, values), self._now_us)

    def request_parameter(self, name: str) -> None:
        """Request a parameter once; its value appears in `parameters`."""
        self.send(
            common.MAVLink_param_request_read_message(
                self._system, AUTOPILOT_COMPONENT, name.encode("ascii"), -1
            )
        )
        self._requested.add(name)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter, whose type is that of the value, int or float; `parameters` has the result."""
        kind = common.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int):
            kind = common.MAV_PARAM_TYPE_INT32
            if self.interface.integers_are_bytes:
                value = struct.unpack("<f", struct.pack("<i", value))[0]
        self.send(
            common.MAVLink_param_set_message(
                self._system, AUTOPILOT_COMPONENT, name.encode("ascii"), value, kind
            )
        )
        self._requested.add(name)

    def send(self, message: Message | PositionTarget) -> None:
        """Send any message to the autopilot, at the end of the iteration.

        Raises TypeError, OverflowError or `struct.error` for what is no MAVLink message, or has fields of
        wrong types or out of range, and ValueError for more than `MOST_MESSAGES` in one iteration.
        """
        check_message(message)
        if len(self._outgoing) >= MOST_MESSAGES:
            raise ValueError(f"more than {MOST_MESSAGES} messages in one iteration of the loop")
        self._outgoing.append(message)

    # ---- of the host

    def on_message(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot, before the applications receive it."""
        own = self.own
        match message.get_type():
            case "LOCAL_POSITION_NED":
                own.on_local_position(message, now_us)
            case "GPS_RAW_INT":
                own.on_gps(message)
            case "ALTITUDE":
                own.on_altitude(message)
            case "SCALED_PRESSURE" if self.interface.barometer_message == "SCALED_PRESSURE":
                own.on_pressure(message)
            case "SYS_STATUS":
                own.on_status(message)
            case "GPS_GLOBAL_ORIGIN":
                own.on_origin(message)
            case "HEARTBEAT":
                own.on_heartbeat(message, now_us)
            case "COMMAND_ACK":
                self.commands.on_ack(message, now_us)
            case "PARAM_VALUE":
                if message.param_id in self._requested:
                    self.parameters[message.param_id] = self._value(message)

    def begin(self, now_us: int) -> None:
        """Begin an iteration of the loop: advance the flight that `take_off` began."""
        self._now_us = now_us
        own = self.own
        if self.flight is FlightState.ARMING and self._take_off.arm(own, now_us, since_us=self._since_us):
            self.flight = FlightState.TAKING_OFF
        if self.flight is not FlightState.TAKING_OFF and self.flight is not FlightState.FOLLOWING:
            return
        self._has_flown |= own.armed and -own.odometry_ned_m[2] > FLOWN_HEIGHT_M
        if self._has_flown and not own.armed:
            self.flight = FlightState.LANDED
            self.commands.request(None, now_us)
        elif self.flight is FlightState.TAKING_OFF:
            self._climb(now_us)

    def take(self, now_us: int) -> list[Message | PositionTarget]:
        """Return what is to be sent in this iteration."""
        outgoing, self._outgoing = self._outgoing, []
        outgoing += self.commands.on_timer(now_us)
        return outgoing

    def _climb(self, now_us: int) -> None:
        own = self.own
        if self._take_off.climb(own, now_us, height_m=self._height_m):
            self.flight = FlightState.FOLLOWING
        if not self.interface.follows_before_take_off:  # it needs setpoints before it changes to the mode
            north_m, east_m = own.local_ne_m
            down_m = own.height.down_m + own.height.autopilot_down_m
            mask = _IGNORE_ACC | _IGNORE_YAW | _IGNORE_YAW_RATE
            self.send(
                PositionTarget(
                    now_us // 1_000, self._system, AUTOPILOT_COMPONENT, _LOCAL_NED, mask,
                    north_m, east_m, down_m, 0.0, 0.0, own.vel_ned_m_s[2] + own.height.vel_error_m_s,
                )
            )  # fmt: skip

    def _given(self, name: str, axes: Axes | None) -> tuple[Vector, int]:
        """Return a vector with 0 for axes that are not given, and the bits of those that are."""
        if axes is None:
            return _ZERO, 0
        try:
            north, east, down = (None if axis is None else float(axis) for axis in axes)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{name}: {axes!r:.100}; expected three numbers") from None
        vector = (north or 0.0, east or 0.0, down or 0.0)
        if not all(abs(value) <= MOST for value in vector):
            raise ValueError(f"{name}: {axes!r:.100}; expected finite numbers, at most {MOST:g}")
        given = (north is not None) | (east is not None) << 1 | (down is not None) << 2
        if given not in {0, _ALL_AXES} and not self.interface.mixes_axes:
            raise ValueError(f"{name}: {axes!r:.100}; expected all three axes beside an ArduPilot")
        return vector, given

    def _value(self, message: Message) -> float:
        value: float = message.param_value
        integers = (common.MAV_PARAM_TYPE_INT32, common.MAV_PARAM_TYPE_UINT32)
        if self.interface.integers_are_bytes and message.param_type in integers:
            return float(struct.unpack("<i", struct.pack("<f", value))[0])
        return value


def check_message(message: Message | PositionTarget) -> None:
    """Check that an application's message can be sent.

    Raises TypeError, `struct.error` or OverflowError.
    """
    if isinstance(message, PositionTarget):
        _SETPOINT.pack(*message)
    elif isinstance(message, common.MAVLink_message):
        message.pack(_PACKER)
    else:
        raise TypeError(f"{message!r:.100}; expected a MAVLink message")

"""State of the own vehicle from the autopilot's MAVLink messages: odometry, position, GPS, mode.

Horizontal odometry is the integral of the autopilot's velocity since the first message, as the autopilot's
position follows the GPS bias. Vertical odometry is a continuous height above the ground (`height`), as the
autopilot's may follow the GPS bias too, or be reset.
"""

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.estimation.atmosphere import altitude_m
from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import LocalPosition
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.site_frame import message_ned_m
from autopilot.onboard.client.autopilots import PX4, AutopilotInterface
from autopilot.onboard.client.height import ContinuousHeight
from autopilot.parameters.config import Site
from foundation.types import Vector

PA_PER_HPA = 100.0
_ZERO: Vector = (0.0, 0.0, 0.0)


class Fix(Struct, frozen=True):
    """A GPS position of the antenna at ``time_ms``, corrected for the receiver's delay.

    ``std_h_m`` and ``std_v_m`` are the accuracies that the receiver states; None: not stated.
    """

    time_ms: int
    pos_ned_m: Vector
    std_h_m: float | None = None
    std_v_m: float | None = None


class OwnState:
    """Newest state of the own vehicle; times are on the formation's clock, -1 before the first.

    Attributes:
        time_us: time of the position, the odometry and the velocity.
        odometry_ned_m: horizontally from the application's start, down from the ground.
        vel_ned_m_s: the autopilot's velocity, less the estimated error of its vertical part.
        autopilot_ned_m: horizontally the autopilot's position in the site's frame, down from the ground.
        height: relation of the autopilot's vertical position and velocity to these.
        local_ne_m: the autopilot's position from its own origin, north and east.
        is_ready: whether the autopilot's pre-arm checks pass; None: not reported.
        origin_ned_m: the autopilot's origin in the site's frame; ``origin_alt_m`` is above mean sea level.
        truth_ned_m: true position from the simulator, down from that in its first message.

    """

    def __init__(self, *, site: Site, gps_delay_s: float, autopilot: AutopilotInterface = PX4) -> None:
        self.time_us = -1
        self.odometry_ned_m = _ZERO
        self.vel_ned_m_s = _ZERO
        self.autopilot_ned_m = _ZERO
        self.height = ContinuousHeight()
        self.is_ready: bool | None = None
        self.origin_ned_m: Vector | None = None
        self.origin_alt_m = 0.0
        self.fix: Fix | None = None
        self.truth_ned_m: Vector | None = None
        self.truth_us = -1
        self.armed = False
        self.failsafe = False
        self.mode: FlightMode | None = None
        self.heartbeat_us = -1
        self._autopilot = autopilot
        self._site = site
        self._gps_delay_ms = round(gps_delay_s * 1e3)
        self._boot_offset_us: int | None = None
        self._standing_down_m: float | None = None
        self.local_ne_m = (0.0, 0.0)
        self._standing = False
        """Whether it is known that the vehicle has not been armed yet."""

    def on_local_position(self, msg: Message | LocalPosition, now_us: int) -> bool:
        """Process a LOCAL_POSITION_NED; returns False if it is not newer than the last one."""
        boot_us = msg.time_boot_ms * 1_000
        # Messages can only be late, so the least clock difference observed so far is the best estimate.
        if self._boot_offset_us is None or now_us - boot_us < self._boot_offset_us:
            self._boot_offset_us = now_us - boot_us
        time_us = boot_us + self._boot_offset_us
        if time_us <= self.time_us:
            return False
        vel_n, vel_e, height = msg.vx, msg.vy, self.height
        north_m, east_m, _ = self.odometry_ned_m
        if self.time_us >= 0:
            before_n, before_e, _ = self.vel_ned_m_s
            half_s = 0.5e-6 * (time_us - self.time_us)
            north_m += half_s * (vel_n + before_n)
            east_m += half_s * (vel_e + before_e)
        height.on_position(time_us, msg.z, msg.vz, standing=self._standing)
        self.odometry_ned_m = (north_m, east_m, height.down_m)
        self.local_ne_m = (msg.x, msg.y)
        self._place()
        self.vel_ned_m_s = (vel_n, vel_e, msg.vz - height.vel_error_m_s)
        self.time_us = time_us
        return True

    def on_altitude(self, msg: common.MAVLink_altitude_message) -> None:
        """Process the barometric altitude of an ALTITUDE."""
        if self._boot_offset_us is not None:
            time_us = msg.time_usec + self._boot_offset_us
            self.height.on_barometer(time_us, msg.altitude_monotonic, standing=self._standing)

    def on_pressure(self, msg: common.MAVLink_scaled_pressure_message) -> None:
        """Process the absolute pressure of a SCALED_PRESSURE, for autopilots without ALTITUDE."""
        if self._boot_offset_us is not None and msg.press_abs > 0.0:
            time_us = msg.time_boot_ms * 1_000 + self._boot_offset_us
            self.height.on_barometer(time_us, altitude_m(msg.press_abs * PA_PER_HPA), standing=self._standing)

    def on_status(self, msg: common.MAVLink_sys_status_message) -> None:
        """Process the pre-arm checks of a SYS_STATUS; PX4 reports them in the healthy sensors only."""
        self.is_ready = bool(msg.onboard_control_sensors_health & common.MAV_SYS_STATUS_PREARM_CHECK)

    def on_arming(self) -> None:
        """Keep the zero of the height from now on."""
        self._standing = False

    def on_gps(self, msg: common.MAVLink_gps_raw_int_message) -> bool:
        """Process a GPS_RAW_INT; returns False if it contains no new 3-D position."""
        if msg.fix_type < common.GPS_FIX_TYPE_3D_FIX or self._boot_offset_us is None:
            return False
        time_ms = (msg.time_usec + self._boot_offset_us) // 1_000 - self._gps_delay_ms
        if time_ms < 0 or (self.fix is not None and time_ms <= self.fix.time_ms):
            return False
        pos_ned_m = message_ned_m(self._site, msg.lat, msg.lon, msg.alt)
        # Its eph and epv are dilutions of precision, without a unit; unknown accuracies are 0.
        self.fix = Fix(time_ms, pos_ned_m, msg.h_acc * 1e-3 or None, msg.v_acc * 1e-3 or None)
        return True

    def on_origin(self, msg: common.MAVLink_gps_global_origin_message) -> None:
        """Process a GPS_GLOBAL_ORIGIN."""
        self.origin_alt_m = msg.altitude * 1e-3
        self.origin_ned_m = message_ned_m(self._site, msg.latitude, msg.longitude, msg.altitude)
        self._place()

    def on_truth(self, msg: common.MAVLink_hil_state_quaternion_message) -> None:
        """Process a HIL_STATE_QUATERNION."""
        north_m, east_m, down_m = message_ned_m(self._site, msg.lat, msg.lon, msg.alt)
        if self._standing_down_m is None:
            self._standing_down_m = down_m
        self.truth_ned_m, self.truth_us = (north_m, east_m, down_m - self._standing_down_m), msg.time_usec

    def odometry_at(self, time_us: int) -> Vector:
        """Return the odometry at a time near the newest, extrapolated by the velocity."""
        ahead_s = (time_us - self.time_us) * 1e-6
        (north_m, east_m, down_m), (vel_n, vel_e, vel_d) = self.odometry_ned_m, self.vel_ned_m_s
        return north_m + vel_n * ahead_s, east_m + vel_e * ahead_s, down_m + vel_d * ahead_s

    def on_heartbeat(self, msg: common.MAVLink_heartbeat_message, now_us: int) -> None:
        """Process a HEARTBEAT; those of components other than an autopilot are ignored."""
        if msg.autopilot == common.MAV_AUTOPILOT_INVALID:
            return
        self.armed = bool(msg.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)
        if self.armed:
            self._standing = False
        elif self.heartbeat_us < 0:
            self._standing = True
        self.failsafe = self.armed and msg.system_status >= common.MAV_STATE_CRITICAL
        self.mode = self._autopilot.mode(msg.custom_mode)
        self.heartbeat_us = now_us

    def _place(self) -> None:
        """Convert the autopilot's position to the site's frame, by its origin if that is known."""
        north_m, east_m = self.local_ne_m
        origin_n_m, origin_e_m, _ = self.origin_ned_m or _ZERO
        self.autopilot_ned_m = (north_m + origin_n_m, east_m + origin_e_m, self.height.down_m)

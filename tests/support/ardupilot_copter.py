"""A small flight controller for the stand-in of ArduPilot: modes, arming, and motors of a quadrotor in X.

Conventions are those of ArduCopter: guided mode follows positions, takes off by command and lands by mode;
setpoints end its take-off; motors turn at MOT_SPIN_ARM on the ground and between MOT_SPIN_MIN and
MOT_SPIN_MAX in flight, with the thrust curve of MOT_THST_EXPO. Attitude and height are those of the states,
the horizontal position is integrated from the velocity and corrected by the receiver's fixes.
"""

import math
from collections import deque

STABILIZE, GUIDED, LOITER, RTL, LAND = 0, 4, 5, 6, 9
MODES = {STABILIZE, GUIDED, LOITER, RTL, LAND}
GRAVITY_M_S2 = 9.80665
EARTH_RADIUS_M = 6_378_137.0
POSITION_GAIN_1_S, VELOCITY_GAIN_1_S, CLIMB_INTEGRAL_1_S2 = 1.0, 2.5, 1.0
ANGLE_GAIN_1_S, RATE_GAIN_1_S, YAW_RATE_GAIN_1_S = 5.0, 20.0, 5.0
ANGULAR_RAD_S2, YAW_ANGULAR_RAD_S2 = 175.0, 26.0
"""Angular accelerations of the simulator's vehicle for the whole range of all motors' thrusts."""
FASTEST_M_S, STEEPEST = 5.0, 0.5
TAKE_OFF_M_S, LAND_M_S = 1.5, 0.7
LANDED_M, LANDED_US = 0.15, 1_000_000
ALIGN_US = 2_000_000
"""Time from the first fix until the position is used; ArduPilot's takes some tens of seconds."""
IGNORES_POSITION, IGNORES_VELOCITY, IGNORES_ACCELERATION = 0x007, 0x038, 0x1C0
MIXER = ((-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1))
"""Roll, pitch and yaw by motor: front right, back left, front left, back right."""

Vector = tuple[float, float, float]


def limited(vector: tuple[float, ...], most: float) -> tuple[float, ...]:
    size = math.hypot(*vector)
    return tuple(each * min(1.0, most / size) for each in vector) if size > 0.0 else vector


def axes_of(q: tuple[float, ...]) -> tuple[Vector, Vector, Vector]:
    """Return forward, right and down of a body in NED."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class Copter:
    """One vehicle; ``home`` is latitude and longitude in degrees and altitude in m, its local origin."""

    def __init__(self, parameters: dict[str, float], home: tuple[float, float, float]) -> None:
        self.parameters = parameters
        self.home = home
        self.mode = STABILIZE
        self.armed = False
        self.landed = True
        self.time_us = 0
        self.values: dict[str, tuple[float, ...]] = {}
        """Of the newest state."""
        self.pos_ned_m = [0.0, 0.0, 0.0]
        self.fix_us: int | None = None
        """Time of the first fix."""
        self.target_pos_m: list[float] | None = None
        self.target_vel_m_s = [0.0, 0.0, 0.0]
        self.target_acc_m_s2 = [0.0, 0.0, 0.0]
        self.takes_off_to_m: float | None = None
        """Down coordinate at which the take-off ends; None: no take-off."""
        self._history: deque[tuple[int, float, float]] = deque(maxlen=250)
        self._climb_m_s2 = 0.0
        """Integral of the climb's error."""
        self._yaw_rad = 0.0
        self._ground_m = 0.0
        self._low_us: int | None = None

    @property
    def is_ready(self) -> bool:
        """Whether the pre-arm checks pass: the position has been known for a while."""
        return self.fix_us is not None and self.time_us - self.fix_us >= ALIGN_US

    # ---- commands: each returns whether it is accepted

    def set_mode(self, mode: int) -> bool:
        if mode == self.mode:
            return True
        if mode not in MODES or (mode != STABILIZE and not self.is_ready):
            return False
        self.mode = mode
        self.takes_off_to_m = None
        self._hold()
        return True

    def arm(self) -> bool:
        if self.mode in {RTL, LAND} or not self.is_ready:
            return False
        if not self.armed:
            self.armed, self.landed = True, True
            self._ground_m, self._climb_m_s2 = self.pos_ned_m[2], 0.0
            self._yaw_rad = self._heading_rad()
            self._hold()
        return True

    def disarm(self) -> bool:
        if not self.landed:
            return False
        self.armed, self.takes_off_to_m = False, None
        return True

    def take_off(self, height_m: float) -> bool:
        if not self.armed or not self.landed or self.mode != GUIDED or height_m <= -self.pos_ned_m[2]:
            return False
        self.takes_off_to_m = -height_m
        self._hold()
        return True

    def follow(self, mask: int, pos_ned_m: Vector, vel_ned_m_s: Vector, acc_ned_m_s2: Vector) -> None:
        """Process a setpoint, which guided mode alone accepts."""
        if self.mode != GUIDED:
            return
        self.takes_off_to_m = None
        self.target_pos_m = None if mask & IGNORES_POSITION else list(pos_ned_m)
        self.target_vel_m_s = [0.0] * 3 if mask & IGNORES_VELOCITY else list(vel_ned_m_s)
        self.target_acc_m_s2 = [0.0] * 3 if mask & IGNORES_ACCELERATION else list(acc_ned_m_s2)

    def _hold(self) -> None:
        self.target_pos_m = list(self.pos_ned_m)
        self.target_vel_m_s, self.target_acc_m_s2 = [0.0] * 3, [0.0] * 3

    # ---- inputs

    def on_fix(self, lat_deg: float, lon_deg: float) -> None:
        """Correct the position by a fix that is as old as GPS1_DELAY_MS."""
        radius_m = EARTH_RADIUS_M + self.home[2]
        north_m = math.radians(lat_deg - self.home[0]) * radius_m
        east_m = math.radians(lon_deg - self.home[1]) * radius_m * math.cos(math.radians(self.home[0]))
        if self.fix_us is None:
            self.fix_us = self.time_us
            self.pos_ned_m[:2] = north_m, east_m
            self._history.clear()
            return
        taken_us = self.time_us - self.parameters.get("GPS1_DELAY_MS", 0.0) * 1e3
        then = next((each for each in self._history if each[0] >= taken_us), None)
        if then is not None:
            self.pos_ned_m[0] += 0.1 * (north_m - then[1])
            self.pos_ned_m[1] += 0.1 * (east_m - then[2])

    def update(self, time_us: int, values: dict[str, tuple[float, ...]]) -> None:
        """Process a state."""
        dt_s = (time_us - self.time_us) * 1e-6
        self.time_us, self.values = time_us, values
        vel_n, vel_e, _ = values["velocity"]
        self.pos_ned_m[0] += vel_n * dt_s
        self.pos_ned_m[1] += vel_e * dt_s
        self.pos_ned_m[2] = values["position"][2]
        self._history.append((time_us, self.pos_ned_m[0], self.pos_ned_m[1]))

    # ---- motors

    def pulses_us(self, dt_s: float) -> list[int]:
        """Return the pulse widths of the four motors."""
        least, most = self.parameters["MOT_PWM_MIN"], self.parameters["MOT_PWM_MAX"]
        if not self.values or not self.armed:
            controls = [0.0] * 4
        elif self._stays_on_ground():
            controls = [self.parameters["MOT_SPIN_ARM"]] * 4
        else:
            controls = self._controls(dt_s)
        return [round(least + control * (most - least)) for control in controls]

    def _stays_on_ground(self) -> bool:
        if self.takes_off_to_m is not None:
            self.landed = False
        elif not self.landed and self.mode in {RTL, LAND}:
            low = self.pos_ned_m[2] > self._ground_m - LANDED_M and abs(self.values["velocity"][2]) < 0.1
            self._low_us = (self._low_us or self.time_us) if low else None
            if self._low_us is not None and self.time_us - self._low_us > LANDED_US:
                self.landed, self.armed, self._low_us = True, False, None
        return self.landed

    def _controls(self, dt_s: float) -> list[float]:
        acc_n, acc_e, acc_d = self._acceleration(dt_s)
        up = max(GRAVITY_M_S2 - acc_d, 2.0)
        acc_n, acc_e = limited((acc_n, acc_e), STEEPEST * up)
        forward, right, down = axes_of(self.values["quaternion"])
        size = math.sqrt(acc_n * acc_n + acc_e * acc_e + up * up)
        wanted_down = (-acc_n / size, -acc_e / size, up / size)
        # the axis that turns the thrust to its direction, in body coordinates
        roll_error = -dot(right, wanted_down)
        pitch_error = dot(forward, wanted_down)
        yaw_error = math.remainder(self._yaw_rad - self._heading_rad(), 2.0 * math.pi)
        rates = self.values["gyro"]
        roll, pitch = (
            RATE_GAIN_1_S * (ANGLE_GAIN_1_S * error - rate) / ANGULAR_RAD_S2
            for error, rate in zip((roll_error, pitch_error), rates[:2], strict=True)
        )
        yaw = YAW_RATE_GAIN_1_S * (limited((yaw_error,), 1.0)[0] - rates[2]) / YAW_ANGULAR_RAD_S2
        yaw = max(-0.1, min(0.1, yaw))
        thrust = self.parameters["MOT_THST_HOVER"] * size * max(dot(down, wanted_down), 0.5) / GRAVITY_M_S2
        return [
            self._control(thrust + sign_roll * roll + sign_pitch * pitch + sign_yaw * yaw)
            for sign_roll, sign_pitch, sign_yaw in MIXER
        ]

    def _acceleration(self, dt_s: float) -> list[float]:
        """Return the acceleration that the target requires, in NED."""
        vel_m_s = self.values["velocity"]
        wanted_m_s = list(self.target_vel_m_s)
        if self.target_pos_m is not None:
            error_m = tuple(a - b for a, b in zip(self.target_pos_m, self.pos_ned_m, strict=True))
            speeds_m_s = limited(tuple(POSITION_GAIN_1_S * each for each in error_m), FASTEST_M_S)
            wanted_m_s = [a + b for a, b in zip(wanted_m_s, speeds_m_s, strict=True)]
        if self.takes_off_to_m is not None:
            ahead_m = self.takes_off_to_m - self.pos_ned_m[2]
            wanted_m_s[2] = max(-TAKE_OFF_M_S, min(TAKE_OFF_M_S, POSITION_GAIN_1_S * ahead_m))
        elif self.mode in {RTL, LAND}:
            wanted_m_s[2] = LAND_M_S
        errors_m_s = [a - b for a, b in zip(wanted_m_s, vel_m_s, strict=True)]
        self._climb_m_s2 += CLIMB_INTEGRAL_1_S2 * errors_m_s[2] * dt_s
        self._climb_m_s2 = max(-2.0, min(2.0, self._climb_m_s2))
        acc_m_s2 = [a + VELOCITY_GAIN_1_S * b for a, b in zip(self.target_acc_m_s2, errors_m_s, strict=True)]
        acc_m_s2[2] += self._climb_m_s2
        return acc_m_s2

    def _control(self, thrust: float) -> float:
        """Return the control of a motor, 0..1, of its share of the range of thrusts."""
        expo = self.parameters["MOT_THST_EXPO"]
        thrust = max(0.0, min(1.0, thrust))
        if expo > 0.0:
            root = math.sqrt((1.0 - expo) ** 2 + 4.0 * expo * thrust)
            thrust = (root - (1.0 - expo)) / (2.0 * expo)
        least, most = self.parameters["MOT_SPIN_MIN"], self.parameters["MOT_SPIN_MAX"]
        return least + thrust * (most - least)

    def _heading_rad(self) -> float:
        w, x, y, z = self.values["quaternion"]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

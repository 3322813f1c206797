"""Decides for each measurement whether it is fused or rejected, or whether the state is reset to it.

One `Fusion` exists from one alignment to the next. It works on the filter at its delayed horizon and records
every kind of measurement. ``estimator`` has queues and validity, ``health`` the checks over time, ``kernels``
the arithmetic.
"""

import math
from enum import IntFlag

import numpy as np

from autopilot.estimation import kernels
from autopilot.estimation.aiding import Aiding
from autopilot.estimation.correction import CORRECTED, CORRECTED_AT, MEASURED, STEP, advance_and_correct
from autopilot.estimation.health import (
    COMPASS_ERROR_RAD,
    HEADING_KNOWN_RAD,
    Compass,
    NavigationTest,
    StuckBarometer,
    VerticalConflict,
    field_checks,
)
from autopilot.estimation.horizon import DelayedHorizon
from autopilot.estimation.params import PX4_FILTER_PERIOD_S, EstimatorParams
from autopilot.estimation.yaw_gsf import YawBank
from foundation.geometry.geodesy import place_ned_m
from foundation.geometry.rotations import quat_from_rotation_vector, quat_multiply
from foundation.types import Array, GpsFix, Triple, Vector

HORIZONTAL_RESET_US = 7_000_000
HEIGHT_RESET_US = 5_000_000
"""After a longer time of rejections the state is reset to the measurement; PX4's times."""
YAW_EMERGENCY_US = 1_000_000
"""After a longer time of rejected velocity or position the heading is checked; PX4's EKFGSF_reset_delay."""
BARO_FRESH_US = 500_000
"""An older pressure is not used to check a fix."""
BAD_ACCEL_NOISE_M_S2 = 4.9
"""Replaces EKF2_ACC_NOISE while the accelerometer is contradicted; PX4's value."""
EMERGENCY_TILT_STD_RAD = math.radians(3.0)
EMERGENCY_GYRO_BIAS_STD_RAD_S = 0.003
"""Standard deviations of tilt and gyro bias after a yaw emergency."""
FIX_3D = 3
ORIGIN_FIXES = 5
HOLD_PERIOD_US = 200_000
VERTICAL_VELOCITY_NOISE_RATIO = 1.5
"""GPS velocity is less accurate vertically; PX4's ratio."""

NEVER_US = 1 << 62
_NO_FIELD: Vector = (0.0, 0.0, 0.0)
Aid = tuple[int, Vector | None, float | None]
"""Time, and the magnetic field (3,) FRD in gauss and pressure altitude in metres measured at that time."""
Origin = tuple[float, float, float]
"""Latitude and longitude in degrees, altitude in metres above mean sea level."""


class Jump(IntFlag):
    """Parts of the state that were reset."""

    NONE = 0
    POSITION = 1
    HEIGHT = 2
    VELOCITY = 4
    YAW = 8


class Fusion:
    """Fuses the measurements that the horizon has reached, one by one."""

    def __init__(
        self,
        params: EstimatorParams,
        delayed: DelayedHorizon,
        *,
        ground_altitude_m: float,
        origin: Origin | None,
    ) -> None:
        """Start from an alignment; ``origin`` is known if it is not the first."""
        self.origin = origin
        self._step = np.zeros(1, STEP)
        self._step_octets = self._step.view(np.uint8).data
        step = self._step[0]
        self.velocity, self.position = Aiding.of(3), Aiding.of(2)
        """GPS velocity, innovation (3,) NED m/s; GPS position, innovation (2,) north and east m"""
        self.height = Aiding(step["height_innovation_m"], step["height_var_m2"])
        """Barometer, innovation (1,) down m"""
        self.heading = Aiding(step["heading_innovation_rad"], step["heading_var_rad2"])
        """Magnetometer, innovation (1,) rad; also recorded while the compass is not used"""
        self.height.accepted_us = self.heading.accepted_us = delayed.horizon_us
        self.compass = Compass()
        self.barometer = StuckBarometer()
        self.vertical = VerticalConflict()
        self.navigation = NavigationTest()
        self.bank = YawBank(delayed.level)
        self.bank_turn_rad = 0.0
        """Heading of the bank minus the filter's, at the last fix"""
        self.held_pos_m: Array | None = None
        """(2,) position that is held during long dead reckoning"""
        self.held_us = 0
        """Time of the last call of `hold_position`, rounded down to the period."""
        self.jumps = Jump.NONE
        """Resets since the caller cleared it."""
        self.done: tuple[bool, float] | None = None
        """Whether the filter is sound after field and pressure of the last sample, and its greater variance
        of tilt, rad^2; None if there were none."""
        self._delayed = delayed
        self._ground_altitude_m = ground_altitude_m
        self._placed = False
        """Whether the horizontal position has come from a fix."""
        self._origin_fixes: list[GpsFix] = []
        self.set_params(params)

    def set_params(self, params: EstimatorParams) -> None:
        """Change noises, gates and limits, in effect from the next measurement."""
        self._params = params
        self._field_ned = np.array(params.magnetic_field_ned_gauss)
        self._field_checks = field_checks(params)
        self._bias_limits = np.array([params.gyro_bias_limit_rad_s, params.accel_bias_limit_m_s2])
        self._heading_var_rad2 = params.heading_noise_rad**2
        vel_var = params.gps_vel_noise_m_s**2
        self._vel_var = np.array([vel_var, vel_var, VERTICAL_VELOCITY_NOISE_RATIO**2 * vel_var])
        self._baro_var = np.array([params.baro_noise_m**2])
        step = self._step[0]
        step["field_ned_gauss"], step["field_off_max"] = self._field_ned, self._field_checks
        step["heading_noise_var_rad2"], step["heading_gate"] = self._heading_var_rad2, params.heading_gate
        step["height_noise_var_m2"], step["height_gate"] = self._baro_var, params.baro_gate
        step["bias_limits"] = self._bias_limits
        self._hold_var = np.full(2, params.no_aid_noise_m**2)
        self._set_noise()

    def unaided(self, horizon_us: int, timeout_us: int) -> bool:
        """Return whether no horizontal measurement was accepted within the time-out."""
        return self.velocity.absent(horizon_us, timeout_us) and self.position.absent(horizon_us, timeout_us)

    # -- inertial samples, with field and pressure

    def advance(
        self, time_us: int, dt_s: float, gyro_frd_rad_s: Triple, accel_frd_m_s2: Triple, aid: Aid | None
    ) -> int:
        """Process an inertial sample, (3,) each; return the result of `horizon.advance`.

        Field and pressure of the same time, ``aid``, are fused as by `fuse_mag` and `fuse_baro` and
        propagated to the present if the horizon has reached them; ``done`` then has the result. Pairs that
        need a decision in between are skipped: a field that could reset the heading before the pressure is
        fused, and a repeated pressure, which is checked with the filter's velocity.
        """
        delayed, compass = self._delayed, self.compass
        self.done = None
        pair_us, field_frd_gauss, altitude_m = NEVER_US, _NO_FIELD, 0.0
        if aid is not None:
            aid_us, field, altitude = aid
            if (
                field is not None
                and altitude is not None
                and not self.barometer.repeats(altitude)
                and not self.heading.absent(aid_us, HORIZONTAL_RESET_US)
            ):
                pair_us, field_frd_gauss, altitude_m = aid_us, field, altitude
        down_m = self._ground_altitude_m - altitude_m
        octets = self._step_octets
        MEASURED.pack_into(
            octets, 0, time_us, dt_s, *gyro_frd_rad_s, *accel_frd_m_s2,
            pair_us, not compass.faulty, *field_frd_gauss, down_m,
        )  # fmt: skip
        horizon_us: int = advance_and_correct(delayed.block, delayed.samples, self._step)
        if horizon_us >= pair_us:
            heading_ratio, height_ratio, tilt_var_rad2, disturbed, sound = CORRECTED.unpack_from(
                octets, CORRECTED_AT
            )
            compass.disturbed = disturbed != 0
            self.barometer.note(altitude_m, 0.0, pair_us)
            self._record_heading(pair_us, heading_ratio)
            self._record_height(pair_us, down_m, height_ratio)
            self.done = (sound != 0, tilt_var_rad2)
        return horizon_us

    # -- single measurements; the result is whether the state changed

    def fuse_mag(self, time_us: int, field_frd_gauss: Array) -> bool:
        """Fuse the heading of a magnetic field (3,) FRD."""
        x, cov, compass = self._delayed.x, self._delayed.cov, self.compass
        heading = self.heading
        heading.innovation[0], heading.innovation_var[0], ratio, compass.disturbed = kernels.fuse_field(
            x, cov, field_frd_gauss, self._field_ned, self._field_checks, self._heading_var_rad2,
            self._params.heading_gate, self._bias_limits, not compass.faulty,
        )  # fmt: skip
        return self._record_heading(time_us, ratio)

    def _record_heading(self, time_us: int, ratio: float) -> bool:
        """Record a heading measurement; reset to it if it was rejected for long."""
        compass = self.compass
        if not (compass.disturbed or compass.faulty) and self.heading.record(ratio, time_us):
            return True
        x, cov, innovation_rad = self._delayed.x, self._delayed.cov, float(self.heading.innovation[0])
        if compass.disturbed or compass.faulty:
            self.heading.refuse(ratio, time_us)
            if compass.faulty:
                agrees = ratio < 1.0 and abs(innovation_rad) < COMPASS_ERROR_RAD
                known = cov[2, 2] < HEADING_KNOWN_RAD**2
                compass.note(consistent=bool(agrees and known and not compass.disturbed), time_us=time_us)
            return False
        if not self.heading.absent(time_us, HORIZONTAL_RESET_US):
            return False
        if self.bank.std_rad < HEADING_KNOWN_RAD:
            turn_rad = self.bank.turn_rad(x[:4])
            if abs(math.remainder(innovation_rad - turn_rad, 2.0 * math.pi)) > COMPASS_ERROR_RAD:
                compass.faulty = abs(turn_rad) < COMPASS_ERROR_RAD
                return False
        self._turn(innovation_rad, self._heading_var_rad2)
        self.heading.accepted_us = time_us
        return True

    def fuse_baro(self, time_us: int, altitude_m: float) -> bool:
        """Fuse a pressure altitude as the height above the ground of the alignment."""
        vel_down_m_s = float(self._delayed.x[kernels.VEL + 2])
        if self.barometer.note(altitude_m, vel_down_m_s, time_us):
            self.height.refuse(math.inf, time_us)
            return False
        down_m = self._ground_altitude_m - altitude_m
        ratio = self._take_in(
            self.height, kernels.POS + 2, np.array((down_m,)), self._baro_var, self._params.baro_gate
        )
        return self._record_height(time_us, down_m, ratio)

    def _record_height(self, time_us: int, down_m: float, ratio: float) -> bool:
        """Record a height measurement; reset to it if it was rejected for long."""
        taken = self.height.record(ratio, time_us)
        if not taken and self.height.absent(time_us, HEIGHT_RESET_US):
            at_m = np.array((down_m,))
            self._reset(self.height, kernels.POS + 2, at_m, self._baro_var, Jump.HEIGHT, time_us)
            return True
        return taken

    def fuse_fix(self, fix: GpsFix) -> bool:
        """Fuse velocity and horizontal position of a fix."""
        delayed, params = self._delayed, self._params
        measured_us = fix.time_us - params.gps_delay_us
        if not self._is_usable(fix):
            self._origin_fixes.clear()
            return False
        self.bank.fuse(fix.vel_ned_m_s[:2], params.gps_vel_noise_m_s)
        self.bank_turn_rad = self.bank.turn_rad(delayed.x[:4])
        if self.origin is None:
            self._origin_fixes.append(fix)
            if len(self._origin_fixes) < ORIGIN_FIXES:
                return False
            self.origin = self._mean_fix()
        velocity_taken = self._fuse(
            self.velocity, kernels.VEL, fix.vel_ned_m_s, self._vel_var, params.gps_vel_gate, measured_us
        )
        # the fix may be older than the horizon by a fraction of a step, or because it arrived late
        age_s = (delayed.horizon_us - measured_us) * 1e-6
        pos_m = self._horizontal_pos_m(fix) + age_s * fix.vel_ned_m_s[:2]
        pos_var = np.full(2, max(fix.eph_m, params.gps_pos_noise_m) ** 2)
        velocity_taken = self._reset_vertical(fix, measured_us, velocity_taken=velocity_taken)
        if not self._placed:
            self._placed = True
            self._reset(self.position, kernels.POS, pos_m, pos_var, Jump.POSITION, measured_us)
            return True
        position_taken = self._fuse(
            self.position, kernels.POS, pos_m, pos_var, params.gps_pos_gate, measured_us
        )
        velocity_lost = not velocity_taken and self.velocity.absent(measured_us, YAW_EMERGENCY_US)
        position_lost = not position_taken and self.position.absent(measured_us, YAW_EMERGENCY_US)
        emergency = (velocity_lost or position_lost) and self._yaw_emergency()
        if emergency or (velocity_lost and self.velocity.absent(measured_us, HORIZONTAL_RESET_US)):
            self._reset(
                self.velocity, kernels.VEL, fix.vel_ned_m_s, self._vel_var, Jump.VELOCITY, measured_us
            )
            velocity_taken = True
        if emergency or (position_lost and self.position.absent(measured_us, HORIZONTAL_RESET_US)):
            self._reset(self.position, kernels.POS, pos_m, pos_var, Jump.POSITION, measured_us)
            position_taken = True
        self.navigation.note(
            velocity_taken=velocity_taken, position_taken=position_taken, measured_us=measured_us
        )
        if velocity_taken and not self.compass.faulty:
            self.bank.learn_gyro_bias(delayed.x[kernels.GYRO_BIAS : kernels.ACCEL_BIAS])
        if velocity_taken or position_taken:
            self.held_pos_m = None
        return velocity_taken or position_taken

    def hold_position(self) -> bool:
        """Bound the tilt error of long dead reckoning by fusing the last position with large noise."""
        delayed = self._delayed
        self.held_us = delayed.horizon_us - delayed.horizon_us % HOLD_PERIOD_US  # in step with others
        if not self.unaided(delayed.horizon_us, self._params.no_aid_timeout_us):
            return False
        if self.held_pos_m is None:
            self.held_pos_m = delayed.x[kernels.POS : kernels.POS + 2].copy()
        self._take_in(Aiding.of(2), kernels.POS, self.held_pos_m, self._hold_var, math.inf)
        return True

    # -- resets

    def _reset_vertical(self, fix: GpsFix, measured_us: int, *, velocity_taken: bool) -> bool:
        """Reset vertically to GPS velocity and barometer if they contradict the accelerometer.

        Returns whether the fix's velocity is fused now: its horizontal part may have been rejected only
        because of the vertical part. Until the accelerometer is consistent again its process noise is
        increased, so that the filter relies on the other two.
        """
        velocity, height, delayed = self.velocity, self.height, self._delayed
        if height.measured_us is None or measured_us - height.measured_us > BARO_FRESH_US:
            return velocity_taken
        was_bad = self.vertical.bad
        contradicted = not self.barometer.stuck and self.vertical.note(
            velocity.innovation[2] / math.sqrt(velocity.innovation_var[2]),
            height.innovation[0] / math.sqrt(height.innovation_var[0]),
            measured_us,
        )
        if self.vertical.bad != was_bad:
            self._set_noise()
        if not contradicted:
            return velocity_taken
        down_m = delayed.x[kernels.POS + 2 : kernels.POS + 3] + height.innovation
        self._reset(height, kernels.POS + 2, down_m, self._baro_var, Jump.HEIGHT, measured_us)
        delayed.reset(kernels.VEL + 2, fix.vel_ned_m_s[2:], self._vel_var[2:])
        self.jumps |= Jump.VELOCITY
        if not velocity_taken:
            gate = self._params.gps_vel_gate
            ratio = self._take_in(Aiding.of(2), kernels.VEL, fix.vel_ned_m_s[:2], self._vel_var[:2], gate)
            velocity_taken = bool(ratio < 1.0)
            if velocity_taken:
                velocity.accepted_us = measured_us
        return velocity_taken

    def _set_noise(self) -> None:
        noise = self._delayed.noise
        noise.gyro_psd, noise.accel_psd, noise.gyro_bias_psd, noise.accel_bias_psd = (
            self._params.process_noise_psd
        )
        if self.vertical.bad:
            noise.accel_psd = max(noise.accel_psd, BAD_ACCEL_NOISE_M_S2**2 * PX4_FILTER_PERIOD_S)

    def _yaw_emergency(self) -> bool:
        """Reset to the heading that GPS velocity implies, if it is accurate and differs from the filter's.

        Fusion under the wrong heading has corrupted tilt and biases: attitude and gyro bias are set to those
        of the bank's complementary filter, which does not use GPS, and the accelerometer bias variance is
        reset.
        """
        delayed, bank, params = self._delayed, self.bank, self._params
        turn_rad = bank.turn_rad(delayed.x[:4])
        known = bank.std_rad < HEADING_KNOWN_RAD and abs(turn_rad) > COMPASS_ERROR_RAD
        if not known:  # also if one of them is not a number
            return False
        delayed.x[:4] = bank.q_ned_frd()
        delayed.x[kernels.GYRO_BIAS : kernels.ACCEL_BIAS] = bank.gyro_bias_rad_s
        tilt_var = EMERGENCY_TILT_STD_RAD**2
        delayed.reset_covariance(0, np.array([tilt_var, tilt_var, bank.std_rad**2]))
        delayed.reset_covariance(9, np.full(3, EMERGENCY_GYRO_BIAS_STD_RAD_S**2))
        delayed.reset_covariance(12, np.full(3, params.accel_bias_init_m_s2**2))
        # even if the compass is consistent now: while turning, a wrong one sweeps over all headings
        self.compass.faulty = True
        self.jumps |= Jump.YAW
        return True

    def _turn(self, turn_rad: float, heading_var: float) -> None:
        delayed = self._delayed
        turn = quat_from_rotation_vector(np.array([0.0, 0.0, turn_rad]))
        delayed.x[:4] = quat_multiply(turn, delayed.x[:4])
        delayed.reset_covariance(2, np.array([heading_var]))
        self.jumps |= Jump.YAW

    def _reset(
        self, aiding: Aiding, first: int, measured: Array, variance: Array, kind: Jump, measured_us: int
    ) -> None:
        self._delayed.reset(first, measured, variance)
        aiding.accepted_us = measured_us
        self.jumps |= kind

    # -- helpers

    def _fuse(
        self, aiding: Aiding, first: int, measured: Array, variance: Array, gate: float, measured_us: int
    ) -> bool:
        """Fuse a measurement of the states from ``first``; return whether it was accepted."""
        return aiding.record(self._take_in(aiding, first, measured, variance, gate), measured_us)

    def _take_in(self, aiding: Aiding, first: int, measured: Array, variance: Array, gate: float) -> float:
        """Fuse a measurement of the states from ``first``; return its test ratio."""
        ratio: float = kernels.fuse_direct(
            self._delayed.x, self._delayed.cov, first, measured, variance, gate, self._bias_limits,
            aiding.innovation, aiding.innovation_var,
        )  # fmt: skip
        return ratio

    def _is_usable(self, fix: GpsFix) -> bool:
        numbers = (fix.lat_deg, fix.lon_deg, fix.alt_m, fix.eph_m, *fix.vel_ned_m_s.tolist())
        return (
            fix.fix_type >= FIX_3D
            and fix.satellites >= self._params.gps_required_satellites
            and fix.eph_m <= self._params.gps_required_eph_m
            and all(map(math.isfinite, numbers))
        )

    def _mean_fix(self) -> Origin:
        fixes = self._origin_fixes
        down_m = float(self._delayed.x[kernels.POS + 2])
        # longitudes are averaged as differences, for sites at the date line
        first_lon_deg = fixes[0].lon_deg
        lon_offset_deg = sum(math.remainder(fix.lon_deg - first_lon_deg, 360.0) for fix in fixes) / len(fixes)
        origin = (
            sum(fix.lat_deg for fix in fixes) / len(fixes),
            math.remainder(first_lon_deg + lon_offset_deg, 360.0),
            sum(fix.alt_m for fix in fixes) / len(fixes) + down_m,
        )
        fixes.clear()
        return origin

    def _horizontal_pos_m(self, fix: GpsFix) -> Array:
        lat_deg, lon_deg, alt_m = self.origin or (0.0, 0.0, 0.0)
        north_m, east_m, _ = place_ned_m(fix.lat_deg, fix.lon_deg, fix.alt_m, lat_deg, lon_deg, alt_m)
        return np.array((north_m, east_m))

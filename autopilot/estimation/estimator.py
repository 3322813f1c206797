"""The estimator: an error-state Kalman filter in the manner of PX4's EKF2, 15 errors at a delayed horizon.

Aligns on the ground at rest, takes the first good GPS fixes as its origin, and then fuses GPS velocity and
horizontal position, barometric height and magnetic heading. This module decides what is fused, refused and
reset; the arithmetic is in ``kernels``, the delay in ``horizon``, the first second in ``alignment``.
"""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from autopilot.estimation import atmosphere, kernels
from autopilot.estimation.alignment import Aligned, Alignment
from autopilot.estimation.diagnostics import Aiding, EstimatorDiagnostics
from autopilot.estimation.horizon import ACC, ESTIMATE, NOT_FINITE, OMEGA, STD, DelayedHorizon
from autopilot.estimation.params import EstimatorParams
from autopilot.estimation.rotation import quat_from_rotation_vector, quat_multiply
from autopilot.navigation.geodesy import geodetic_to_ned
from autopilot.types import Array, EstimatorState, GpsFix, ImuSample

HORIZONTAL_RESET_US = 7_000_000
HEIGHT_RESET_US = 5_000_000
"""Refused for longer, a measurement is believed and the state reset to it; PX4's times."""
DEAD_RECKONING_US = 1_000_000
NEVER_US = 1 << 62
FIX_3D = 3
ORIGIN_FIXES = 5
HOLD_PERIOD_US = 200_000
VERTICAL_VELOCITY_NOISE_RATIO = 1.5
"""GPS velocity is worse vertically; PX4's ratio."""
WAITING_MAX = 256
"""Measurements waiting for the horizon, of each kind: beyond it the inertial sensor has failed anyway."""


class Estimator:
    """Attitude, velocity, position and inertial biases of one vehicle from its sensors.

    Measurements may come in any order within a step, before the inertial sample that ends it. What is not
    finite is dropped, and so are inertial samples not later than the one before.
    """

    def __init__(self, params: EstimatorParams) -> None:
        self._params = params
        self._field_ned = np.array(params.magnetic_field_ned_gauss)
        self._bias_limits = np.array([params.gyro_bias_limit_rad_s, params.accel_bias_limit_m_s2])
        vel_var = params.gps_vel_noise_m_s**2
        self._vel_var = np.array([vel_var, vel_var, VERTICAL_VELOCITY_NOISE_RATIO**2 * vel_var])
        self._baro_var = np.array([params.baro_noise_m**2])
        self._hold_var = np.full(2, params.no_aid_noise_m**2)
        self._alignment = Alignment(params)
        self._filter: DelayedHorizon | None = None
        self._ground_altitude_m = 0.0
        self._origin_fixes: list[GpsFix] = []
        self._origin_deg_m: tuple[float, float, float] | None = None
        self._fixes: deque[GpsFix] = deque(maxlen=WAITING_MAX)
        self._baros: deque[tuple[int, float]] = deque(maxlen=WAITING_MAX)
        self._mags: deque[tuple[int, Array]] = deque(maxlen=WAITING_MAX)
        self._velocity = Aiding(np.zeros(3))
        self._position = Aiding(np.zeros(2))
        self._height = Aiding(np.zeros(1))
        self._heading = Aiding(np.zeros(1))
        self._held_pos_m: Array | None = None
        self._held_us = 0
        self._time_us = -1
        self._due_us = 0
        """Nothing is to be fused while the horizon is before this."""
        self._aided_until_us = self._height_until_us = -1
        """Up to which horizon velocity and position, and the height, count as known."""
        estimate = np.zeros(ESTIMATE)
        estimate[0] = 1.0
        self.live = _state_over(estimate)
        """The state at the last inertial sample: the one object, rewritten by the next sample, for those who
        read it and keep nothing."""
        self._state: EstimatorState | None = None

    # -- sensors

    def on_imu(self, sample: ImuSample) -> None:
        """Take the inertial sample of the interval that ends at its time, and bring the state there."""
        if sample.time_us <= self._time_us:
            return
        if self._filter is None:
            self._align(sample)
            return
        horizon_us = self._filter.add(sample.time_us, sample.gyro_frd_rad_s, sample.accel_frd_m_s2)
        if horizon_us == NOT_FINITE:
            return
        self._time_us = sample.time_us
        if horizon_us >= self._due_us:
            self._fuse_due(self._filter, horizon_us)
        self._bring_up_to_date(horizon_us)

    def on_gps(self, fix: GpsFix) -> None:
        """Take a fix; it is fused when the horizon reaches ``fix.time_us`` less the delay."""
        if self._filter is not None:
            self._fixes.append(fix)
            self._due_us = 0

    def on_baro(self, time_us: int, pressure_hpa: float, temperature_degc: float) -> None:  # noqa: ARG002
        """Take a static pressure.

        The temperature is that of the sensor on its warm board, not of the air, and is left unused: heights
        are those of the standard atmosphere, as in PX4.
        """
        if not (math.isfinite(pressure_hpa) and pressure_hpa > 0.0):
            return
        altitude_m = atmosphere.altitude_m(pressure_hpa * 100.0)
        if self._filter is None:
            self._alignment.add_baro(altitude_m)
        else:
            self._baros.append((time_us, altitude_m))
            self._due_us = 0

    def on_mag(self, time_us: int, field_frd_gauss: Array) -> None:
        """Take a magnetic field, (3,) FRD."""
        if not kernels.all_finite(field_frd_gauss):
            return
        if self._filter is None:
            self._alignment.add_mag(field_frd_gauss)
        else:
            self._mags.append((time_us, field_frd_gauss.copy()))
            self._due_us = 0

    # -- results

    @property
    def state(self) -> EstimatorState:
        """The state at the last inertial sample, to keep; its deviations are the delayed horizon's."""
        if self._state is None:
            live = self.live
            self._state = replace(
                live,
                **{name: getattr(live, name).copy() for name in _ARRAYS},
            )
        return self._state

    @property
    def diagnostics(self) -> EstimatorDiagnostics | None:
        """How the filter does, once it is aligned. The records of aiding are live, the arrays copies."""
        if self._filter is None:
            return None
        return EstimatorDiagnostics(
            horizon_us=self._filter.horizon_us,
            velocity=self._velocity,
            position=self._position,
            height=self._height,
            heading=self._heading,
            dead_reckoning=self._unaided(self._filter.horizon_us, DEAD_RECKONING_US),
            position_held=self._held_pos_m is not None,
            x=self._filter.x.copy(),
            covariance=self._filter.cov.copy(),
        )

    # -- what is fused

    def _align(self, sample: ImuSample) -> None:
        gyro_frd_rad_s = sample.gyro_frd_rad_s
        if not (kernels.all_finite(sample.accel_frd_m_s2) and kernels.all_finite(gyro_frd_rad_s)):
            return
        self._time_us = sample.time_us
        self.live.omega_frd_rad_s[:] = gyro_frd_rad_s
        aligned = self._alignment.add_imu(sample)
        if aligned is not None:
            self._start(aligned)
            self.live.omega_frd_rad_s[:] = gyro_frd_rad_s - self.live.gyro_bias_rad_s
        self._bring_up_to_date(self._time_us)

    def _start(self, aligned: Aligned) -> None:
        self._ground_altitude_m = aligned.baro_altitude_m
        self._height.accepted_us = self._time_us
        self._heading.accepted_us = self._time_us
        self._filter = DelayedHorizon(
            aligned.x,
            aligned.cov,
            time_us=self._time_us,
            delay_us=self._params.gps_delay_us,
            noise_psd=np.array(self._params.process_noise_psd),
        )
        self.live = _state_over(self._filter.estimate)
        self.live.attitude_valid = True
        self._note_validity()

    def _bring_up_to_date(self, horizon_us: int) -> None:
        """Set what the kernels do not write of the live state."""
        live = self.live
        live.time_us = self._time_us
        aided = horizon_us <= self._aided_until_us
        live.velocity_valid = aided
        live.position_valid = aided and self._origin_deg_m is not None
        live.height_valid = horizon_us <= self._height_until_us
        self._state = None

    def _note_validity(self) -> None:
        """Set until when the state counts as known, from what was accepted last."""
        for aiding in (self._velocity, self._position):
            if aiding.accepted_us is not None:
                until_us = aiding.accepted_us + self._params.no_aid_timeout_us
                self._aided_until_us = max(self._aided_until_us, until_us)
        if self._height.accepted_us is not None:
            self._height_until_us = self._height.accepted_us + HEIGHT_RESET_US

    def _fuse_due(self, delayed: DelayedHorizon, horizon_us: int) -> None:
        """Fuse what the horizon has reached."""
        mags, baros, fixes = self._mags, self._baros, self._fixes
        delay_us = self._params.gps_delay_us
        corrected = False
        while mags and mags[0][0] <= horizon_us:
            corrected |= self._fuse_mag(delayed, *mags.popleft())
        while baros and baros[0][0] <= horizon_us:
            corrected |= self._fuse_baro(delayed, *baros.popleft())
        while fixes and fixes[0].time_us - delay_us <= horizon_us:
            corrected |= self._fuse_fix(delayed, fixes.popleft())
        if horizon_us - self._held_us >= HOLD_PERIOD_US:
            corrected |= self._hold_position(delayed)
        if corrected:
            delayed.corrected()
        self._note_validity()
        self._due_us = min(
            self._held_us + HOLD_PERIOD_US,
            mags[0][0] if mags else NEVER_US,
            baros[0][0] if baros else NEVER_US,
            fixes[0].time_us - delay_us if fixes else NEVER_US,
        )

    def _fuse_mag(self, delayed: DelayedHorizon, time_us: int, field_frd_gauss: Array) -> bool:
        innovation_rad = kernels.heading_innovation(delayed.x, field_frd_gauss, self._field_ned)
        variance = self._params.heading_noise_rad**2
        self._heading.innovation[0] = innovation_rad
        ratio = kernels.fuse_heading(
            delayed.x,
            delayed.cov,
            innovation_rad,
            self._field_ned,
            variance,
            self._params.heading_gate,
            self._bias_limits,
        )
        if self._heading.record(ratio, time_us):
            return True
        if not self._heading.absent(time_us, HORIZONTAL_RESET_US):
            return False
        turn = quat_from_rotation_vector(np.array([0.0, 0.0, innovation_rad]))
        delayed.x[:4] = quat_multiply(turn, delayed.x[:4])
        delayed.reset_covariance(2, np.array([variance]))
        self._note_reset(self._heading, time_us)
        return True

    def _fuse_baro(self, delayed: DelayedHorizon, time_us: int, altitude_m: float) -> bool:
        down_m = np.array([self._ground_altitude_m - altitude_m])
        return self._fuse_or_reset(
            delayed,
            self._height,
            kernels.POS + 2,
            down_m,
            self._baro_var,
            self._params.baro_gate,
            time_us,
            HEIGHT_RESET_US,
        )

    def _fuse_fix(self, delayed: DelayedHorizon, fix: GpsFix) -> bool:
        measured_us = fix.time_us - self._params.gps_delay_us
        if not self._good(fix):
            self._origin_fixes.clear()
            return False
        pos_var = np.full(2, max(fix.eph_m, self._params.gps_pos_noise_m) ** 2)
        if self._origin_deg_m is None:
            self._origin_fixes.append(fix)
            if len(self._origin_fixes) < ORIGIN_FIXES:
                return False
            self._set_origin(delayed)
            delayed.reset(kernels.POS, self._horizontal_pos_m(fix), pos_var)
            self._note_reset(self._position, measured_us)
        # the fix may be older than the horizon by a fraction of a step, or by what it came late
        age_s = (delayed.horizon_us - measured_us) * 1e-6
        pos_m = self._horizontal_pos_m(fix) + age_s * fix.vel_ned_m_s[:2]
        params = self._params
        fused = self._fuse_or_reset(
            delayed,
            self._velocity,
            kernels.VEL,
            fix.vel_ned_m_s,
            self._vel_var,
            params.gps_vel_gate,
            measured_us,
            HORIZONTAL_RESET_US,
        )
        fused |= self._fuse_or_reset(
            delayed,
            self._position,
            kernels.POS,
            pos_m,
            pos_var,
            params.gps_pos_gate,
            measured_us,
            HORIZONTAL_RESET_US,
        )
        if fused:
            self._held_pos_m = None
        return fused

    def _hold_position(self, delayed: DelayedHorizon) -> bool:
        """Without horizontal measurements pull loosely to the last known position: it keeps tilt bounded."""
        self._held_us = delayed.horizon_us
        if not self._unaided(delayed.horizon_us, self._params.no_aid_timeout_us):
            return False
        if self._held_pos_m is None:
            self._held_pos_m = delayed.x[kernels.POS : kernels.POS + 2].copy()
        kernels.fuse_direct(
            delayed.x,
            delayed.cov,
            kernels.POS,
            self._held_pos_m,
            self._hold_var,
            math.inf,
            self._bias_limits,
            np.empty(2),
        )
        return True

    # -- helpers

    def _fuse_or_reset(
        self,
        delayed: DelayedHorizon,
        aiding: Aiding,
        first: int,
        measured: Array,
        variance: Array,
        gate: float,
        measured_us: int,
        reset_us: int,
    ) -> bool:
        """Fuse a measurement of the states from ``first``, or set them to it after a long refusal."""
        ratio = kernels.fuse_direct(
            delayed.x, delayed.cov, first, measured, variance, gate, self._bias_limits, aiding.innovation
        )
        if aiding.record(ratio, measured_us):
            return True
        if not aiding.absent(measured_us, reset_us):
            return False
        delayed.reset(first, measured, variance)
        self._note_reset(aiding, measured_us)
        return True

    def _note_reset(self, aiding: Aiding, measured_us: int) -> None:
        aiding.accepted_us = measured_us
        self.live.reset_counter += 1

    def _unaided(self, horizon_us: int, timeout_us: int) -> bool:
        return self._velocity.absent(horizon_us, timeout_us) and self._position.absent(horizon_us, timeout_us)

    def _good(self, fix: GpsFix) -> bool:
        numbers = np.array((fix.lat_deg, fix.lon_deg, fix.alt_m, fix.eph_m, *fix.vel_ned_m_s))
        return bool(
            fix.fix_type >= FIX_3D
            and fix.satellites >= self._params.gps_required_satellites
            and fix.eph_m <= self._params.gps_required_eph_m
            and kernels.all_finite(numbers)
        )

    def _set_origin(self, delayed: DelayedHorizon) -> None:
        fixes = self._origin_fixes
        down_m = float(delayed.x[kernels.POS + 2])
        # longitudes are averaged as differences: the site may lie on the date line
        first_lon_deg = fixes[0].lon_deg
        lon_offset_deg = sum(math.remainder(fix.lon_deg - first_lon_deg, 360.0) for fix in fixes) / len(fixes)
        self._origin_deg_m = (
            sum(fix.lat_deg for fix in fixes) / len(fixes),
            math.remainder(first_lon_deg + lon_offset_deg, 360.0),
            sum(fix.alt_m for fix in fixes) / len(fixes) + down_m,
        )
        live = self.live
        live.origin_lat_deg, live.origin_lon_deg, live.origin_alt_m = self._origin_deg_m
        fixes.clear()

    def _horizontal_pos_m(self, fix: GpsFix) -> Array:
        lat_deg, lon_deg, alt_m = self._origin_deg_m or (0.0, 0.0, 0.0)
        pos_ned_m = geodetic_to_ned(
            fix.lat_deg,
            fix.lon_deg,
            fix.alt_m,
            origin_lat_deg=lat_deg,
            origin_lon_deg=lon_deg,
            origin_alt_m=alt_m,
        )
        return pos_ned_m[:2]


_ARRAYS = (
    "q_ned_frd", "vel_ned_m_s", "pos_ned_m", "omega_frd_rad_s", "acc_ned_m_s2", "gyro_bias_rad_s",
    "accel_bias_m_s2", "pos_std_m", "vel_std_m_s", "attitude_std_rad",
)  # fmt: skip


def _state_over(estimate: Array) -> EstimatorState:
    """Give a state that is nothing but views of the horizon's estimate, as yet not valid."""
    return EstimatorState(
        time_us=0,
        q_ned_frd=estimate[: kernels.VEL],
        vel_ned_m_s=estimate[kernels.VEL : kernels.POS],
        pos_ned_m=estimate[kernels.POS : kernels.GYRO_BIAS],
        omega_frd_rad_s=estimate[OMEGA : OMEGA + 3],
        acc_ned_m_s2=estimate[ACC : ACC + 3],
        gyro_bias_rad_s=estimate[kernels.GYRO_BIAS : kernels.ACCEL_BIAS],
        accel_bias_m_s2=estimate[kernels.ACCEL_BIAS : kernels.STATES],
        pos_std_m=estimate[STD + 6 : STD + 9],
        vel_std_m_s=estimate[STD + 3 : STD + 6],
        attitude_std_rad=estimate[STD : STD + 3],
        origin_lat_deg=0.0,
        origin_lon_deg=0.0,
        origin_alt_m=0.0,
        attitude_valid=False,
        velocity_valid=False,
        position_valid=False,
        height_valid=False,
        reset_counter=0,
    )

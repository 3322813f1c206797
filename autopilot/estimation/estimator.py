"""The estimator: an error-state Kalman filter after PX4's EKF2, with 15 errors at a delayed horizon.

It aligns at rest on the ground, sets its origin from the first good GPS fixes, and then fuses GPS velocity
and horizontal position, barometric height and magnetic heading. This module has the sensors' queues and
determines validity and reset deltas of the state. ``fusion`` decides what is fused, rejected and reset;
``kernels`` has the arithmetic, ``horizon`` the delay, ``alignment`` the initial second.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from autopilot.estimation import atmosphere, kernels
from autopilot.estimation.alignment import Aligned, Alignment
from autopilot.estimation.clock import Clock
from autopilot.estimation.fusion import HEIGHT_RESET_US, HOLD_PERIOD_US, NEVER_US, Aid, Fusion, Jump, Origin
from autopilot.estimation.horizon import NOT_FINITE, DelayedHorizon
from autopilot.estimation.params import EstimatorParams
from foundation.geometry.rotations import quat_conjugate, quat_multiply
from foundation.types import EstimatorState, GpsFix, ImuSample

WAITING_MAX = 256
"""Waiting measurements of each kind; more can only wait if the inertial sensor has failed."""
TILT_STD_MAX_RAD = math.radians(20.0)
"""Greatest standard deviation of tilt of a valid attitude."""


class Estimator:
    """Estimates attitude, velocity, position and inertial biases of one vehicle from its sensors.

    Measurements may arrive in any order within a step, before its inertial sample. Measurements that are not
    finite are dropped, and so are inertial samples outside the range of sensors or not later than the last
    one.
    """

    def __init__(self, params: EstimatorParams, clock: Clock | None = None) -> None:
        """``clock`` is that of the vehicle; the estimator writes its ``estimate_us``. None creates one."""
        self.clock = Clock() if clock is None else clock
        self._params = params
        self._alignment = Alignment(params)
        self.filter: DelayedHorizon | None = None
        """The filter, once it is aligned"""
        self.fusion: Fusion | None = None
        """What is fused and rejected, with the diagnostics of each kind of measurement; likewise"""
        self._ground_altitude_m: float | None = None
        """Pressure altitude of the first alignment."""
        self._origin: Origin | None = None
        self._failed = False
        self._fixes: deque[GpsFix] = deque(maxlen=WAITING_MAX)
        self._aids: deque[Aid] = deque(maxlen=WAITING_MAX)
        self._due_us = 0
        """Nothing is fused while the horizon is before this time."""
        self._aided_until_us = self._height_until_us = -1
        """Horizon until which velocity and position, and the height, are valid."""
        self.live = _unknown_state()
        """State at ``clock.estimate_us``: one object that every sample overwrites, for readers that do not
        store it."""

    # -- sensors

    def on_imu(self, sample: ImuSample) -> None:
        """Process the inertial sample of the interval that ends at its time, and update the state."""
        time_us, before_us = sample.time_us, self.clock.estimate_us
        if not before_us < time_us < NEVER_US:
            return
        if self.filter is None or self.fusion is None:
            self._align(sample)
            return
        if self._failed:
            self._coast(sample)
            return
        aids, fusion = self._aids, self.fusion
        dt_s = (time_us - before_us) * 1e-6
        horizon_us = fusion.advance(
            time_us, dt_s, sample.gyro_frd_rad_s, sample.accel_frd_m_s2, aids[0] if aids else None
        )
        if horizon_us == NOT_FINITE:
            return
        self.clock.estimate_us = time_us
        if horizon_us >= self._due_us:
            self._fuse_due(self.filter, fusion, horizon_us)
        self._update_live(horizon_us)

    def on_gps(self, fix: GpsFix) -> None:
        """Queue a fix; it is fused when the horizon reaches ``fix.time_us`` minus the delay."""
        if self.filter is not None:
            self._fixes.append(fix)
            self._due_us = 0

    def on_baro(self, time_us: int, pressure_hpa: float, temperature_degc: float) -> None:  # noqa: ARG002
        """Queue a static pressure.

        The temperature is not used: it is that of the sensor on its warm board, not of the air. Heights are
        those of the standard atmosphere, as in PX4.
        """
        if not (math.isfinite(pressure_hpa) and pressure_hpa > 0.0):
            return
        altitude_m = atmosphere.altitude_m(pressure_hpa * 100.0)
        if self.filter is None:
            self._alignment.add_baro(altitude_m)
        else:
            field_frd_gauss = None
            if self._aids and self._aids[-1][0] == time_us and self._aids[-1][2] is None:
                field_frd_gauss = self._aids.pop()[1]
            self._aids.append((time_us, field_frd_gauss, altitude_m))
            self._due_us = 0

    def on_mag(self, time_us: int, field_frd_gauss: Sequence[float]) -> None:
        """Queue a magnetic field, (3,) FRD."""
        x, y, z = field_frd_gauss
        if not math.isfinite(x + y + z):
            return
        if self.filter is None:
            self._alignment.add_mag(np.array((x, y, z)))
        else:
            self._aids.append((time_us, (x, y, z), None))
            self._due_us = 0

    # -- commands

    @property
    def params(self) -> EstimatorParams:
        """The settings in effect."""
        return self._params

    def set_params(self, params: EstimatorParams) -> None:
        """Change noises, gates and limits, in effect from the next measurement.

        Raises ValueError for another GPS delay after the alignment, because the horizon would have to move;
        use `restart` for that.
        """
        if self.filter is not None and params.gps_delay_us != self._params.gps_delay_us:
            raise ValueError("the GPS delay cannot change while the estimator runs")
        self._params = params
        self._alignment.set_params(params)
        if self.filter is not None and self.fusion is not None:
            self.fusion.set_params(params)

    def restart(self, params: EstimatorParams | None = None) -> None:
        """Restart with an alignment, for a disarmed vehicle at rest on the ground.

        Origin and height reference are kept, so the local frame does not change; the estimates are discarded.
        """
        self._params = params or self._params
        self._alignment = Alignment(self._params)
        self.filter = self.fusion = None
        self._failed = False
        for waiting in (self._fixes, self._aids):
            waiting.clear()
        self._aided_until_us = self._height_until_us = -1
        self.live.attitude_valid = self.live.navigation_failed = False
        self._update_live(self.clock.estimate_us)

    def on_landed(self) -> None:
        """Clear the fault of the compass after the vehicle has come to rest on the ground."""
        if self.fusion is not None:
            self.fusion.compass.clear()

    @property
    def valid_until_us(self) -> int:
        """Horizon until which nothing is to be fused and the whole state stays valid; -1: not valid now.

        Until then `horizon.advance` on the memory of ``filter`` is equivalent to `on_imu`.
        """
        live = self.live
        if self._failed or not (live.velocity_valid and live.position_valid and live.height_valid):
            return -1
        return min(self._due_us, self._aided_until_us + 1, self._height_until_us + 1)

    # -- results

    @property
    def numerical_failure(self) -> bool:
        """Whether the filter's state is no longer finite, which requires `restart`."""
        return self._failed

    @property
    def state(self) -> EstimatorState:
        """Copy of the state at the last inertial sample; standard deviations refer to the delayed horizon."""
        live = self.live
        return replace(
            live,
            pos_reset_delta_ned_m=live.pos_reset_delta_ned_m.copy(),
            vel_reset_delta_ned_m_s=live.vel_reset_delta_ned_m_s.copy(),
        )

    # -- parts of a step

    def _align(self, sample: ImuSample) -> None:
        gyro_frd_rad_s = np.array(sample.gyro_frd_rad_s)
        if not kernels.is_plausible(gyro_frd_rad_s, np.array(sample.accel_frd_m_s2)):
            return
        self.clock.estimate_us = sample.time_us
        self.live.omega_frd_rad_s[:] = gyro_frd_rad_s - self.live.gyro_bias_rad_s
        aligned = self._alignment.add_imu(sample)
        if aligned is not None:
            self._start(aligned)
            self.live.omega_frd_rad_s[:] = gyro_frd_rad_s - self.live.gyro_bias_rad_s
        self._update_live(sample.time_us)

    def _start(self, aligned: Aligned) -> None:
        if self._ground_altitude_m is None:
            self._ground_altitude_m = aligned.baro_altitude_m
        aligned.x[kernels.POS + 2] = self._ground_altitude_m - aligned.baro_altitude_m
        self.filter = DelayedHorizon(
            aligned.x, aligned.cov, time_us=self.clock.estimate_us, delay_us=self._params.gps_delay_us
        )
        self.fusion = Fusion(
            self._params, self.filter, ground_altitude_m=self._ground_altitude_m, origin=self._origin
        )
        before = self.live
        self.live = replace(before)
        self.live.use_memory(self.filter.estimate)
        self.live.attitude_valid = True
        if self._origin is not None:
            self._note_jump(before, Jump.POSITION | Jump.HEIGHT | Jump.VELOCITY | Jump.YAW)
        self._note_validity(self.fusion)

    def _update_live(self, horizon_us: int) -> None:
        """Update the fields of the live state that kernels do not write."""
        live = self.live
        aided = horizon_us <= self._aided_until_us
        live.velocity_valid = aided
        live.position_valid = aided and self._origin is not None
        live.height_valid = horizon_us <= self._height_until_us

    def _note_validity(self, fusion: Fusion) -> None:
        """Set until when the state is valid, from the last accepted measurements."""
        live = self.live
        live.navigation_failed = fusion.navigation.failed
        if live.navigation_failed:
            self._aided_until_us = -1
        else:
            accepted_us = max(fusion.velocity.accepted_us or -1, fusion.position.accepted_us or -1)
            if accepted_us >= 0:
                self._aided_until_us = accepted_us + self._params.no_aid_timeout_us
        if fusion.height.accepted_us is not None:
            self._height_until_us = fusion.height.accepted_us + HEIGHT_RESET_US

    def _fuse_due(self, delayed: DelayedHorizon, fusion: Fusion, horizon_us: int) -> None:
        """Fuse the measurements that the horizon has reached."""
        aids, fixes = self._aids, self._fixes
        delay_us = self._params.gps_delay_us
        corrected = False
        done = fusion.done
        if done is not None:
            aids.popleft()
        while aids and aids[0][0] <= horizon_us:
            time_us, field_frd_gauss, altitude_m = aids.popleft()
            if field_frd_gauss is not None:
                corrected |= fusion.fuse_mag(time_us, np.array(field_frd_gauss))
            if altitude_m is not None:
                corrected |= fusion.fuse_baro(time_us, altitude_m)
        while fixes and fixes[0].time_us - delay_us <= horizon_us:
            corrected |= fusion.fuse_fix(fixes.popleft())
        if horizon_us - fusion.held_us >= HOLD_PERIOD_US:
            corrected |= fusion.hold_position()
        if fusion.jumps:
            self._carry_jump(delayed, fusion)
            done = None
        elif corrected:
            delayed.corrected()
            done = None
        if done is None:
            tilt_var_rad2 = max(delayed.cov.item(0, 0), delayed.cov.item(1, 1))
            done = (kernels.is_sound(delayed.x, delayed.cov), tilt_var_rad2)
        sound, tilt_var_rad2 = done
        if sound:
            self.live.attitude_valid = tilt_var_rad2 <= TILT_STD_MAX_RAD**2
            self._note_validity(fusion)
        else:
            self._fail(delayed)
        self._due_us = min(
            fusion.held_us + HOLD_PERIOD_US,
            aids[0][0] if aids else NEVER_US,
            fixes[0].time_us - delay_us if fixes else NEVER_US,
        )

    def _carry_jump(self, delayed: DelayedHorizon, fusion: Fusion) -> None:
        """Propagate a reset to the present estimate, and record its deltas there."""
        if self._origin is None and fusion.origin is not None:
            self._origin = fusion.origin
            self.live.origin_lat_deg, self.live.origin_lon_deg, self.live.origin_alt_m = fusion.origin
        before = replace(self.live)
        delayed.corrected()
        self._note_jump(before, fusion.jumps)
        fusion.jumps = Jump.NONE

    def _note_jump(self, before: EstimatorState, kinds: Jump) -> None:
        """Count a reset and record the deltas of the live state."""
        live = self.live
        live.reset_counter += 1
        live.pos_reset_counter += Jump.POSITION in kinds
        live.height_reset_counter += Jump.HEIGHT in kinds
        live.vel_reset_counter += Jump.VELOCITY in kinds
        live.yaw_reset_counter += Jump.YAW in kinds
        live.pos_reset_delta_ned_m = live.pos_ned_m - before.pos_ned_m
        live.vel_reset_delta_ned_m_s = live.vel_ned_m_s - before.vel_ned_m_s
        turn = quat_multiply(live.q_ned_frd, quat_conjugate(before.q_ned_frd))
        live.yaw_reset_delta_rad = math.remainder(2.0 * math.atan2(turn[3], turn[0]), 2.0 * math.pi)

    def _fail(self, delayed: DelayedHorizon) -> None:
        """Stop the filter after a numerical failure: nothing is valid, and the estimate is finite."""
        self._failed = True
        self._aided_until_us = self._height_until_us = -1
        live, estimate = self.live, delayed.estimate
        live.attitude_valid = live.navigation_failed = False
        estimate[~np.isfinite(estimate)] = 0.0
        if not np.any(live.q_ned_frd):
            live.q_ned_frd[0] = 1.0

    def _coast(self, sample: ImuSample) -> None:
        """Update the body rates only, after a failure."""
        gyro_frd_rad_s = np.array(sample.gyro_frd_rad_s)
        if not kernels.is_plausible(gyro_frd_rad_s, np.array(sample.accel_frd_m_s2)):
            return
        self.clock.estimate_us = sample.time_us
        self.live.omega_frd_rad_s[:] = gyro_frd_rad_s - self.live.gyro_bias_rad_s
        self._update_live(sample.time_us)


def _unknown_state() -> EstimatorState:
    """Return a state in which nothing is valid, level and at rest."""
    zero = np.zeros(3)
    return EstimatorState(
        q_ned_frd=np.array((1.0, 0.0, 0.0, 0.0)), vel_ned_m_s=zero, pos_ned_m=zero, omega_frd_rad_s=zero,
        acc_ned_m_s2=zero, gyro_bias_rad_s=zero, accel_bias_m_s2=zero, pos_std_m=zero, vel_std_m_s=zero,
        attitude_std_rad=zero, origin_lat_deg=0.0, origin_lon_deg=0.0, origin_alt_m=0.0, reset_counter=0,
        attitude_valid=False, velocity_valid=False, position_valid=False, height_valid=False,
    )  # fmt: skip

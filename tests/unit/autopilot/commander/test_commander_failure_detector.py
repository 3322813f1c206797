"""Timelines of the failure detector: attitude at 4 ms steps, ESC telemetry about every 50 ms. About 2 s."""

from math import radians

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec import structs

from autopilot.commander.failure_detector import (
    ESC_TIMEOUT_US,
    AttitudeFailure,
    FailureDetector,
    FailureDetectorParams,
    thrust_fraction,
)
from autopilot.control.allocation import Allocator
from autopilot.control.params import AllocationParams
from foundation.geometry.rotations import quat_from_euler, quat_to_euler

STEP = 4_000
ESC_PERIOD = 12 * STEP
PARAMS = FailureDetectorParams()
LEVEL = quat_from_euler(0.0, 0.0, 0.0)
TRIGGER_US = 300_000
HOVER_A = 4.0
LINEAR = 0.0
"""Thrust model factor with which controls are fractions of full thrust"""
HOVERING = (0.534,) * 4
ALL_TURN = (HOVER_A,) * 4
SECOND_STANDS = (HOVER_A, 0.0, HOVER_A, HOVER_A)


class Timeline:
    def __init__(self, **changes):
        self.detector = FailureDetector(structs.replace(PARAMS, **changes))
        self.now_us = 0

    def run(self, duration_us, *, q_ned_frd=LEVEL, armed=True, currents_a=ALL_TURN, thrusts=HOVERING):
        """Return when each failure first occurred, relative to the start of this run; None: no telemetry."""
        begin_us, first = self.now_us, {}
        while self.now_us < begin_us + duration_us:
            self.now_us += STEP
            if armed and currents_a is not None and self.now_us % ESC_PERIOD == 0:
                self.detector.on_esc(self.now_us, currents_a, thrusts, LINEAR)
            for failure in AttitudeFailure(self.detector.update(self.now_us, q_ned_frd, armed=armed)):
                first.setdefault(failure, self.now_us - begin_us)
        return first


# ---- attitude


@pytest.mark.parametrize(("failure", "axis"), [(AttitudeFailure.ROLL, 0), (AttitudeFailure.PITCH, 1)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_angle_is_a_failure_from_its_trigger_time_until_it_ends(failure, axis, sign):
    line = Timeline()
    angles_rad = [0.0, 0.0, 1.0]
    angles_rad[axis] = sign * radians(61.0)
    tipped = quat_from_euler(*angles_rad)
    # |...tipped since the first step, at STEP ... trigger time later |
    assert line.run(1_000_000, q_ned_frd=tipped) == {failure: STEP + TRIGGER_US}
    assert line.run(STEP) == {}


def test_a_short_excess_of_an_angle_is_no_failure():
    line = Timeline()
    tipped = quat_from_euler(radians(70.0), 0.0, 0.0)
    for _ in range(5):
        assert line.run(TRIGGER_US, q_ned_frd=tipped) == {}
        line.run(STEP)


@settings(max_examples=300, deadline=None)
@given(
    st.floats(-180.0, 180.0),
    st.floats(-89.0, 89.0),
    st.floats(-180.0, 180.0),
    st.floats(1.0, 180.0),
    st.floats(1.0, 180.0),
)
@example(-180.0, 88.5, 4.0, 1.0, 1.0)
@example(150.0, 80.0, 0.0, 120.0, 120.0)  # the cosine of the tilt is -0.15, that of the limit -0.5
def test_the_angles_are_euler_angles_at_every_attitude(
    roll_deg, pitch_deg, yaw_deg, roll_max_deg, pitch_max_deg
):
    """Against the angles that define the attitude: the short cut for small tilts must not hide a failure."""
    line = Timeline(roll_max_rad=radians(roll_max_deg), pitch_max_rad=radians(pitch_max_deg))
    q_ned_frd = quat_from_euler(radians(roll_deg), radians(pitch_deg), radians(yaw_deg))
    first = line.run(TRIGGER_US + STEP, q_ned_frd=q_ned_frd)
    back_roll_deg, back_pitch_deg, _ = np.degrees(quat_to_euler(q_ned_frd))
    roll_error_deg = (back_roll_deg - roll_deg + 180.0) % 360.0 - 180.0  # -180 degrees may be returned as 180
    assert (roll_error_deg, back_pitch_deg) == pytest.approx((0.0, pitch_deg), abs=1e-6)
    if abs(abs(roll_deg) - roll_max_deg) > 1e-6:
        assert (AttitudeFailure.ROLL in first) == (abs(roll_deg) > roll_max_deg)
    if abs(abs(pitch_deg) - pitch_max_deg) > 1e-6:
        assert (AttitudeFailure.PITCH in first) == (abs(pitch_deg) > pitch_max_deg)


def test_attitude_is_checked_while_disarmed_and_a_limit_of_zero_disables_it():
    upside_down = quat_from_euler(radians(180.0), 0.0, 0.0)
    assert AttitudeFailure.ROLL in Timeline().run(TRIGGER_US + STEP, q_ned_frd=upside_down, armed=False)
    assert Timeline(roll_max_rad=0.0).run(1_000_000, q_ned_frd=upside_down) == {}
    assert Timeline(roll_max_rad=0.0, pitch_max_rad=0.0).run(1_000_000, q_ned_frd=upside_down) == {}
    nose_up = quat_from_euler(0.0, radians(80.0), 0.0)
    assert AttitudeFailure.PITCH in Timeline(roll_max_rad=0.0).run(1_000_000, q_ned_frd=nose_up)


# ---- motors


def test_a_stopped_motor_is_detected_at_the_first_sample_after_the_time_out():
    """Samples are 48 ms apart: low for 96 ms is less than the 100 ms, low for 144 ms is more."""
    line = Timeline()
    line.run(ESC_PERIOD)
    first = line.run(1_000_000, currents_a=SECOND_STANDS)
    assert first == {AttitudeFailure.MOTOR: 4 * ESC_PERIOD}
    assert line.detector.failed_motors == {1}


def test_a_motor_stopped_from_the_start_is_detected_by_the_others_current():
    line = Timeline()
    line.run(1_000_000, currents_a=(0.0,) * 4, thrusts=(0.0,) * 4)
    assert AttitudeFailure.MOTOR in line.run(1_000_000, currents_a=SECOND_STANDS)


def test_it_stays_failed_until_disarmed():
    line = Timeline()
    line.run(1_000_000, currents_a=SECOND_STANDS)
    line.run(1_000_000)
    assert line.detector.failed_motors == {1}
    line.run(200_000, currents_a=(0.0, HOVER_A, HOVER_A, HOVER_A))
    assert line.detector.failed_motors == {0, 1}
    line.run(STEP, armed=False)
    assert line.detector.failed_motors == frozenset()
    assert line.run(1_000_000) == {}


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 12.0), st.floats(0.1, 5.0), st.floats(0.0, 0.9))
def test_the_limit_is_proportional_to_thrust_above_the_least(thrust, current_a, per_thrust_a, thrust_min):
    line = Timeline(motor_current_per_thrust_a=per_thrust_a, motor_thrust_min=thrust_min)
    first = line.run(500_000, currents_a=(current_a, 50.0, 50.0, 50.0), thrusts=(thrust, 0.5, 0.5, 0.5))
    assert (AttitudeFailure.MOTOR in first) == (thrust > thrust_min and current_a < thrust * per_thrust_a)


def test_one_good_sample_restarts_the_time_out():
    line = Timeline()
    for _ in range(20):
        assert line.run(3 * ESC_PERIOD, currents_a=SECOND_STANDS) == {}  # 96 ms from first to last
        assert line.run(ESC_PERIOD) == {}


def test_motors_without_current_measurement_are_not_checked():
    line = Timeline()
    assert line.run(2_000_000, currents_a=(0.0,) * 4) == {}


def test_missing_telemetry_is_detected_and_is_no_motor_failure():
    line = Timeline()
    line.run(2 * ESC_PERIOD, currents_a=SECOND_STANDS)
    # the last sample was in the last step
    first = line.run(1_000_000, currents_a=None)
    assert first == {AttitudeFailure.ESC_TELEMETRY: ESC_TIMEOUT_US + STEP}
    # a low current before the gap is not combined with one after it
    assert AttitudeFailure.MOTOR not in line.run(ESC_PERIOD, currents_a=SECOND_STANDS)
    assert not line.detector.failures


def test_a_vehicle_without_telemetry_reports_no_loss():
    assert Timeline().run(1_000_000, currents_a=None) == {}


def test_settings_act_immediately():
    line = Timeline()
    line.run(1_000_000, currents_a=SECOND_STANDS)
    line.detector.set_params(structs.replace(PARAMS, motor_check=0))
    assert line.detector.failures == 0
    assert line.run(1_000_000, currents_a=SECOND_STANDS) == {}
    line.detector.set_params(structs.replace(PARAMS, roll_max_rad=radians(20.0)))
    assert AttitudeFailure.ROLL in line.run(1_000_000, q_ned_frd=quat_from_euler(radians(30.0), 0.0, 0.0))


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 1.0))
def test_thrust_fraction_inverts_the_allocation(thrust):
    params = AllocationParams()
    controls = Allocator(params).allocate(thrust, np.zeros(3), airmode=True)
    for control in controls.tolist():
        assert thrust_fraction(control, params.thrust_model_factor) == pytest.approx(thrust)

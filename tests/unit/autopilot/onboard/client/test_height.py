"""Height of the own vehicle: steps and drifts of its sources do not reach it."""

import math

import numpy as np
import pytest

from autopilot.onboard.client.height import TIME_CONSTANT_S, ContinuousHeight

POSITION_US, BAROMETER_US = 32_000, 100_000
ORIGIN_M = 488.0


class Flight:
    """A vehicle that stands for 3 s and then climbs at 1.5 m/s to 10 m; `run` feeds its height source.

    The autopilot's vertical position has ``autopilot_error_m(t)``, its velocity ``vel_error_m_s(t)``, the
    barometer ``barometer_error_m(t)``, None: no barometer.
    """

    def __init__(self, *, autopilot_error_m=None, vel_error_m_s=None, barometer_error_m=None, arms=True):
        self.autopilot_error_m = autopilot_error_m or (lambda _: 0.0)
        self.vel_error_m_s = vel_error_m_s or (lambda _: 0.0)
        self.barometer_error_m = barometer_error_m
        self.arms = arms
        self.height = ContinuousHeight()
        self.log = []
        """Time, height error, and setpoint error of an autopilot that controls its own position exactly."""

    def true_down_m(self, time_s):
        return -min(max(1.5 * (time_s - 4.0), 0.0), 10.0) if self.arms else 0.0

    def true_vel_m_s(self, time_s):
        return (self.true_down_m(time_s + 1e-4) - self.true_down_m(time_s - 1e-4)) / 2e-4

    def run(self, seconds):
        for now_us in range(0, round(seconds * 1e6), 4_000):
            time_s = now_us * 1e-6
            standing = time_s < 3.0 or not self.arms
            if now_us % POSITION_US == 0:
                down_m = self.true_down_m(time_s) + self.autopilot_error_m(time_s)
                vel_m_s = self.true_vel_m_s(time_s) + self.vel_error_m_s(time_s)
                self.height.on_position(now_us, down_m, vel_m_s, standing=standing)
                error_m = self.height.down_m - self.true_down_m(time_s)
                frame_m = self.height.autopilot_down_m - self.autopilot_error_m(time_s)
                self.log.append((time_s, error_m, frame_m))
            if now_us % BAROMETER_US == 0 and self.barometer_error_m is not None:
                noise_m = 1e-3 * math.sin(now_us)  # no two values of a barometer are the same
                altitude_m = ORIGIN_M - self.true_down_m(time_s) - self.barometer_error_m(time_s) + noise_m
                self.height.on_barometer(now_us, altitude_m, standing=standing)
        return np.array(self.log)

    def errors_m(self, seconds, *, since_s=0.0):
        rows = self.run(seconds)
        return rows[rows[:, 0] >= since_s, 1]


def step_at(time_s, size_m):
    return lambda now_s: size_m if now_s >= time_s else 0.0


def test_an_autopilot_that_follows_its_gps_does_not_move_the_height():
    """Its position wanders by metres, its velocity by the derivative of that."""
    flight = Flight(
        autopilot_error_m=lambda t: 3.0 * math.sin(2.0 * math.pi * t / 60.0),
        vel_error_m_s=lambda t: 3.0 * 2.0 * math.pi / 60.0 * math.cos(2.0 * math.pi * t / 60.0),
        barometer_error_m=lambda _: 0.0,
    )
    errors_m = flight.errors_m(90.0, since_s=12.0)
    # the observer's error under a velocity error that changes at a m/s^2 is a T^2
    change_m_s2 = 3.0 * (2.0 * math.pi / 60.0) ** 2
    assert np.abs(errors_m).max() < 1.1 * change_m_s2 * TIME_CONSTANT_S**2 + 0.02


def test_a_constant_velocity_error_leaves_no_height_error():
    flight = Flight(vel_error_m_s=lambda _: 0.1, barometer_error_m=lambda _: 0.0)
    assert np.abs(flight.errors_m(40.0, since_s=20.0)).max() < 0.01
    assert flight.height.vel_error_m_s == pytest.approx(0.1, abs=0.005)


@pytest.mark.parametrize("time_s", [1.0, 5.5, 15.0])
def test_a_calibration_of_the_barometer_is_no_change_of_height(time_s):
    flight = Flight(barometer_error_m=step_at(time_s, 4.0))
    assert np.abs(flight.errors_m(25.0)).max() < 0.08
    assert flight.height.steps == (time_s > 3.0)


@pytest.mark.parametrize("has_barometer", [False, True])
@pytest.mark.parametrize("size_m", [-3.0, 1.0])
def test_a_reset_of_the_autopilots_height_moves_its_frame_only(has_barometer, size_m):
    flight = Flight(
        autopilot_error_m=step_at(15.0, size_m), barometer_error_m=(lambda _: 0.0) if has_barometer else None
    )
    rows = flight.run(25.0)
    assert np.abs(rows[:, 1]).max() < 0.05
    # a setpoint in the autopilot's frame is at the same true height before and after
    assert np.abs(rows[:, 2]).max() < 0.05


def test_without_a_barometer_the_height_is_the_autopilots_above_the_ground():
    flight = Flight(autopilot_error_m=lambda t: 0.3 + 0.01 * t)
    errors_m = flight.errors_m(25.0)
    assert np.abs(errors_m[:90]).max() == 0.0  # it stands
    assert errors_m[-1] == pytest.approx(0.01 * 22.0, abs=0.002)


def test_the_barometers_noise_is_reduced():
    noise_m = np.random.default_rng(1).normal(0.0, 0.05, 10_000)
    flight = Flight(barometer_error_m=lambda t: noise_m[round(t * 10.0)], arms=True)
    errors_m = flight.errors_m(300.0, since_s=20.0)
    # noise of density q through (2 s / T + 1 / T^2) / (s + 1 / T)^2 has the variance 5 q / (4 T)
    expected_m = math.sqrt(1.25 * 0.05**2 * 0.1 / TIME_CONSTANT_S)
    assert np.std(errors_m) == pytest.approx(expected_m, rel=0.25)


def test_without_its_barometer_it_continues_with_the_autopilots_height():
    def error_m(time_s):
        return math.nan if 20.0 <= time_s < 25.0 else 0.0

    flight = Flight(vel_error_m_s=lambda _: 0.1, barometer_error_m=error_m)
    # back at the barometer the velocity's error v is unknown again: a double pole leaves at most v T / e
    assert np.abs(flight.errors_m(40.0, since_s=18.0)).max() < 0.1 * TIME_CONSTANT_S / math.e + 0.005


@pytest.mark.parametrize("frozen_s", [(5.0, 15.0), (15.0, 60.0)])
def test_a_frozen_barometer_does_not_take_over_the_height(frozen_s):
    """In the climb and at its end: the autopilot's height is used until the values change again."""
    height, time_s = ContinuousHeight(), 0.0
    errors_m, altitude_m = [], 0.0
    for now_us in range(0, 70_000_000, 4_000):
        time_s = now_us * 1e-6
        down_m = -min(max(1.5 * (time_s - 4.0), 0.0), 10.0)
        vel_m_s = -1.5 if 4.0 < time_s < 4.0 + 10.0 / 1.5 else 0.0
        if now_us % POSITION_US == 0:
            height.on_position(now_us, down_m, vel_m_s, standing=time_s < 3.0)
            errors_m.append(height.down_m - down_m)
        if now_us % BAROMETER_US == 0:
            if not frozen_s[0] <= time_s < frozen_s[1]:
                altitude_m = ORIGIN_M - down_m + 1e-3 * math.sin(now_us)
            height.on_barometer(now_us, altitude_m, standing=time_s < 3.0)
    assert np.abs(errors_m).max() < 0.1
    assert abs(height.vel_error_m_s) < 0.02


def test_an_application_that_starts_in_flight_takes_the_autopilots_height():
    height = ContinuousHeight()
    for now_us in range(0, 5_000_000, 100_000):
        height.on_position(now_us, -8.0, 0.0, standing=False)
        height.on_barometer(now_us, ORIGIN_M + 1e-6 * now_us % 2e-6, standing=False)
    assert height.down_m == pytest.approx(-8.0, abs=0.01)
    assert (height.autopilot_down_m, height.steps) == (pytest.approx(0.0, abs=0.01), 0)


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_lag_of_a_barometer_without_averaging_are_no_steps(seed):
    """ArduPilot reports single samples, up to 0.1 s old: 9 cm of noise, and 15 cm of lag in the climb."""
    rng = np.random.default_rng(seed)
    noise_m, age_s = rng.normal(0.0, 0.09, 10_000), rng.uniform(0.0, 0.1, 10_000)

    def error_m(time_s):
        sample = round(time_s * 10.0)
        return noise_m[sample] + flight.true_down_m(time_s - age_s[sample]) - flight.true_down_m(time_s)

    flight = Flight(barometer_error_m=error_m)
    errors_m = flight.errors_m(600.0, since_s=20.0)
    assert flight.height.steps == 0
    assert np.abs(errors_m).max() < 0.2


def test_a_single_wrong_sample_of_the_barometer_has_no_effect():
    flight = Flight(barometer_error_m=lambda t: 3.0 if 15.0 <= t < 15.05 else 0.0)
    assert np.abs(flight.errors_m(25.0, since_s=12.0)).max() < 0.02
    assert flight.height.steps == 0

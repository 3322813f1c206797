"""The common error process compared with its parameters."""

import math

import numpy as np
import pytest

from harness.world.gauss_markov import STEPS_AHEAD
from harness.world.sensors.config import PROFILES, InertialErrorModel, SensorErrorModel
from harness.world.sensors.errors import SensorError


def series(model, *, samples, interval_s, vehicles=1, seed=0):
    """Draw (samples, vehicles, 3) errors."""
    error = SensorError(model, shape=(vehicles, 3), interval_s=interval_s, rng=np.random.default_rng(seed))
    return np.array([error.next() for _ in range(samples)])


def allan_deviation(values, averaged):
    """Return the RMS difference of neighbouring means of ``averaged`` samples over sqrt(2)."""
    whole = values[: len(values) // averaged * averaged]
    groups = whole.reshape(-1, averaged, *values.shape[1:]).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(groups, axis=0) ** 2))


def test_parts_add_up_to_the_configured_standard_deviation():
    """Over 4000 vehicles: white, turn-on and drift of 3, 4 and 12 give 13 at any time."""
    model = SensorErrorModel(white_std=3.0, turn_on_std=4.0, drift_std=12.0, drift_time_constant_s=50.0)
    first, *_, last = series(model, samples=51, interval_s=1.0, vehicles=4000)
    assert first.std() == pytest.approx(13.0, rel=0.03)
    assert last.std() == pytest.approx(13.0, rel=0.03)
    covariance = np.mean(first * last)
    assert covariance == pytest.approx(4.0**2 + 12.0**2 * math.exp(-1.0), rel=0.1)


def test_white_noise_averages_out_by_the_square_root():
    """Allan deviation of the Gazebo gyro: density / sqrt(averaging time)."""
    density = 8.726646e-4
    model = PROFILES["gazebo"].gyro_rad_s.at_interval(0.004)
    assert model.white_std == pytest.approx(0.0138, abs=5e-5)
    values = series(model, samples=50_000, interval_s=0.004)
    for averaged in (1, 25, 250):
        expected = density / math.sqrt(averaged * 0.004)
        assert allan_deviation(values, averaged) == pytest.approx(
            expected, rel=4.0 / math.sqrt(3 * 50_000 / averaged)
        )


def test_random_walk_grows_by_the_square_root():
    """Far below its correlation time the drift grows as random_walk x sqrt(t)."""
    model = InertialErrorModel(random_walk=6e-3, correlation_s=300.0).at_interval(0.1)
    values = series(model, samples=11, interval_s=0.1, vehicles=3000)
    assert np.std(values[10] - values[0]) == pytest.approx(6e-3 * math.sqrt(1.0), rel=0.04)
    assert values[0].std() == pytest.approx(6e-3 * math.sqrt(150.0), rel=0.04)


def test_data_sheet_densities_do_not_depend_on_the_rate():
    model = InertialErrorModel(noise_density=4e-3)
    slow, fast = (
        series(model.at_interval(dt_s), samples=round(40.0 / dt_s), interval_s=dt_s, vehicles=50)
        for dt_s in (0.02, 0.004)
    )
    assert slow.reshape(40, -1, 50, 3).mean(axis=1).std() == pytest.approx(4e-3, rel=0.06)
    assert fast.reshape(40, -1, 50, 3).mean(axis=1).std() == pytest.approx(4e-3, rel=0.06)


def test_axes_may_differ_and_are_independent():
    model = SensorErrorModel(drift_std=(1.0, 1.0, 5.0), drift_time_constant_s=1.0)
    values = series(model, samples=2, interval_s=1.0, vehicles=5000)[1]
    np.testing.assert_allclose(values.std(axis=0), (1.0, 1.0, 5.0), rtol=0.05)
    assert np.all(np.abs(np.corrcoef(values.T) - np.eye(3)) < 4.0 / math.sqrt(5000.0))


def test_a_model_without_errors_is_zero_but_draws_the_same_numbers():
    rng, reference = np.random.default_rng(1), np.random.default_rng(1)
    error = SensorError(SensorErrorModel(), shape=(4,), interval_s=0.1, rng=rng)
    assert not any(error.next().any() for _ in range(STEPS_AHEAD))
    reference.standard_normal((2 + 2 * STEPS_AHEAD, 4))
    assert rng.bit_generator.state == reference.bit_generator.state


@pytest.mark.parametrize("shape", [(4,), (4, 3)])
def test_samples_equal_those_of_the_recursion(shape):
    """Bit-identical over several blocks of draws, also if they are prepared early."""
    model = SensorErrorModel(white_std=0.3, turn_on_std=2.0, drift_std=0.7, drift_time_constant_s=3.0)
    rng = np.random.default_rng(6)
    error = SensorError(model, shape=shape, interval_s=0.1, rng=np.random.default_rng(6))
    turn_on, drift = rng.standard_normal((2, *shape))
    turn_on, drift = 2.0 * turn_on, 0.7 * drift
    kept = math.exp(-0.1 / 3.0)
    for sample in range(3 * STEPS_AHEAD):
        step, white = rng.standard_normal((2, *shape))
        drift = kept * drift + 0.7 * math.sqrt(1.0 - kept * kept) * step
        if sample % 7 == 0:
            error.draw_ahead()
        assert error.next().tobytes() == (turn_on + drift + 0.3 * white).tobytes()

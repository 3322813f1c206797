"""New random numbers for a state that has drawn in advance: none of the old ones is used, values continue."""

from itertools import pairwise

import numpy as np
import pytest

from harness.world.sensors.config import SensorErrorModel
from harness.world.sensors.errors import SensorError
from harness.world.wind import GustyWind, WindConfig
from harness.world.wind.turbulence import Turbulence, low_altitude_scales
from netsim.model.random_streams import FloatStream

SCALES = low_altitude_scales(10.0, 10.0)


def restart(rng, seed):
    rng.bit_generator.state = np.random.PCG64(seed).state


def sensor(rng):
    model = SensorErrorModel(white_std=0.0, drift_std=1.0, drift_time_constant_s=100.0, turn_on_std=2.0)
    error = SensorError(model, shape=(3,), interval_s=0.01, rng=rng)
    return error, error.next


def gusts(rng):
    wind = GustyWind(WindConfig(mean_n=5.0, gust_time_constant_s=100.0), 3, rng)
    return wind, lambda: wind.step(0.01)


def dryden(rng):
    air = Turbulence("dryden", SCALES, passing_speed_m_s=0.1, series=4, rng=rng)
    return air, lambda: air.step(0.01)


def stream(rng):
    floats = FloatStream(rng.random)
    return floats, floats.draw


@pytest.mark.parametrize("make", [sensor, gusts, dryden, stream])
@pytest.mark.parametrize("taken", [0, 1, 49, 50, 51, 256, 257])
def test_all_values_after_it_come_from_the_new_state(make, taken):
    """Two objects with equal pasts and equal new seeds agree; one with another new seed does not."""
    runs = []
    for seed in (7, 7, 8):
        rng = np.random.default_rng(1)
        drawing, value = make(rng)
        past = [value() for _ in range(taken)]
        restart(rng, seed)
        drawing.discard_drawn()
        runs.append((past, [np.array(value()) for _ in range(300)]))
    np.testing.assert_array_equal(runs[0][0], runs[2][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
    assert not np.any(np.array(runs[0][1]) == np.array(runs[2][1]))


@pytest.mark.parametrize("make", [sensor, gusts, dryden])
def test_values_continue_without_a_jump(make):
    """Time constants are 100 s and more, so a step of 10 ms changes a value by 5 % of its scale at most."""
    rng = np.random.default_rng(1)
    drawing, value = make(rng)
    before = [np.array(value()) for _ in range(77)]
    step = max(np.abs(b - a).max() for a, b in pairwise(before))
    restart(rng, 9)
    drawing.discard_drawn()
    assert np.abs(value() - before[-1]).max() < 3.0 * step


def test_without_a_new_state_a_stream_of_floats_continues_after_whole_blocks():
    reference = np.random.default_rng(3).random(1024)
    floats = FloatStream(np.random.default_rng(3).random)
    floats.take(10)
    floats.discard_drawn()
    assert floats.draw() == reference[FloatStream.BLOCK + 10]

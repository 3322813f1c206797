"""The searched policy follows better than random ones and than none, in wind that the search has not seen."""

import numpy as np
import pytest
from trained_policy.policies import LinearPolicy
from trained_policy.search import mean_error_m, place_from_leader_ned_m, random_weights, search
from trained_policy.task import DURATION_S, make_env

UNSEEN = (20_000, 20_001)
RANDOM_POLICIES = 4


@pytest.fixture(scope="module")
def env():
    env = make_env()
    yield env
    env.close()


def test_the_searched_policy_is_better_than_none_and_than_random_ones(env):
    searched_m = mean_error_m(env, search(env, np.random.default_rng(1), generations=3), UNSEEN)
    zero_m = mean_error_m(env, np.zeros(LinearPolicy.WEIGHTS), UNSEEN)
    rng = np.random.default_rng(2)
    random_m = [mean_error_m(env, random_weights(rng), UNSEEN[:1]) for _ in range(RANDOM_POLICIES)]
    assert searched_m < 0.7 * zero_m
    assert searched_m < 0.7 * np.mean(random_m)


def test_the_leader_moves_and_a_follower_without_errors_stands_still(env):
    observation, _ = env.reset(seed=1)
    policy = LinearPolicy(env.observation_names, place_from_leader_ned_m(), (1.0, 0.0, 0.0, 0.0))
    exact = np.zeros_like(observation)
    first = env.observation_names.index("next_1_pos_n_m")
    exact[first : first + 3] = -place_from_leader_ned_m()
    np.testing.assert_allclose(policy(exact), 0.0, atol=1e-6)
    steps, over = 0, False
    while not over:
        observation, _, terminated, truncated, _ = env.step(np.zeros(3))
        steps, over = steps + 1, terminated or truncated
    assert steps == round(DURATION_S / 0.04)
    speed = np.linalg.norm(observation[first + 3 : first + 5])
    assert 1.0 < speed < 3.0  # of the leader, by its beacons

"""Cross-entropy search for the weights of `LinearPolicy`: ``trained-policy [--generations 6]``.

Each generation flies policies with weights drawn from a normal distribution, and fits that to the best of
them (Rubinstein 1999; de Boer et al. 2005).
"""

import argparse
import sys
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from coflight import load_scenario
from coflight.env import UavEnv
from trained_policy.policies import Doubles, LinearPolicy
from trained_policy.task import OVERRIDES, make_env

POPULATION, ELITE = 12, 3
LEAST_STD = 0.05


def place_from_leader_ned_m() -> Doubles:
    """Return the follower's place from the leader's, (3,)."""
    places_ned_m = load_scenario("article", ["agents=2", *OVERRIDES]).places_ned_m()
    return places_ned_m[1] - places_ned_m[0]


def mean_error_m(env: UavEnv, weights: ArrayLike, seeds: Iterable[int]) -> float:
    """Return the follower's error, mean over the episodes with these seeds; an end counts as 100 m."""
    policy = LinearPolicy(env.observation_names, place_from_leader_ned_m(), weights)
    errors = []
    for seed in seeds:
        observation, _ = env.reset(seed=int(seed))
        rewards, over = [], False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            rewards.append(reward)
            over = terminated or truncated
        errors.append(100.0 if terminated else -np.mean(rewards))
    return float(np.mean(errors))


def random_weights(rng: np.random.Generator) -> Doubles:
    """Return the weights of a random policy, as those of the first generation."""
    return rng.standard_normal(LinearPolicy.WEIGHTS)


def search(
    env: UavEnv, rng: np.random.Generator, *, generations: int = 6, report: Callable[[str], object] = len
) -> Doubles:
    """Return the mean weights of the last generation's best policies; ``report`` receives progress."""
    mean, std = np.zeros(LinearPolicy.WEIGHTS), np.ones(LinearPolicy.WEIGHTS)
    for generation in range(generations):
        seed = rng.integers(10_000)  # one for all, so that policies are compared in the same wind
        population = mean + std * rng.standard_normal((POPULATION, LinearPolicy.WEIGHTS))
        errors_m = [mean_error_m(env, weights, [seed]) for weights in population]
        best = population[np.argsort(errors_m)[:ELITE]]
        mean, std = best.mean(axis=0), np.maximum(best.std(axis=0), LEAST_STD)
        report(f"generation {generation}: {min(errors_m):.2f} m, weights {mean.round(2)}")
    return mean


def main() -> None:
    """Search and compare with the policy that does nothing."""
    parser = argparse.ArgumentParser(description="Search a policy that follows another UAV.")
    parser.add_argument("--generations", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    env, unseen = make_env(), range(20_000, 20_004)
    rng = np.random.default_rng(arguments.seed)
    weights = search(env, rng, generations=arguments.generations, report=show)
    for name, each in (("zero", np.zeros(LinearPolicy.WEIGHTS)), ("searched", weights)):
        show(f"{name}: error {mean_error_m(env, each, unseen):.2f} m in episodes with other seeds")
    env.close()
    show(f"to fly it: coflight fly follow.toml --set 'onboard.settings.weights={weights.round(3).tolist()}'")


def show(text: str) -> None:
    """Write a line to the terminal."""
    sys.stdout.write(text + "\n")

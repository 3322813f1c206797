"""The task: UAV 0 flies a circle in gusty wind, UAV 1 keeps its place beside it, 8.5 m apart.

The follower has the leader's beacons, five a second, and its own position and velocity estimates. Each GPS
receiver has errors of its own, of a metre and more.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

import coflight.env
from coflight.env import EnvState
from harness.env.single import UavEnv

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

SPEED_MAX_M_S = 3.0
RADIUS_M, LEADER_M_S = 6.0, 2.0
DURATION_S = 10.0
OVERRIDES = ["formation.rows=1", "formation.columns=2"]


def lead(observation: Floats) -> Doubles:
    """Return the leader's action (3,): velocity along a circle of `RADIUS_M` whose south is its place."""
    north_m, east_m, down_m = observation[:3]  # its place from it
    from_centre = np.array([-north_m - RADIUS_M, -east_m])
    distance_m = max(np.linalg.norm(from_centre), 0.1)
    outward = from_centre / distance_m
    velocity = LEADER_M_S * np.array([-outward[1], outward[0]]) + (RADIUS_M - distance_m) * outward
    return np.array([*velocity, down_m]) / SPEED_MAX_M_S


def miss(state: EnvState) -> Doubles:
    """Return minus the follower's true error, m, as rewards of both: against its place beside the leader."""
    place_from_leader = state.places_ned_m[1] - state.places_ned_m[0]
    error_m = np.linalg.norm(state.pos_ned_m[1] - state.pos_ned_m[0] - place_from_leader)
    return np.full(2, -error_m - 100.0 * state.ended.any())


def make_env() -> UavEnv:
    """Return the follower's environment."""
    return coflight.env.single_env(
        "article", agents=2, uav=1, others=lead, overrides=OVERRIDES, duration_s=DURATION_S, reward=miss,
        speed_max_m_s=SPEED_MAX_M_S,
    )  # fmt: skip


class LinearPolicy:
    """Velocity = weights of four vectors, the same for each axis; created with an environment's names.

    The vectors: the way to the place beside the leader at the beacon's time, the leader's velocity, that
    velocity times the beacon's age, the own velocity.
    """

    WEIGHTS = 4

    def __init__(self, names: Sequence[str], from_leader_ned_m: ArrayLike, weights: ArrayLike) -> None:
        index = names.index
        self._vel, self._leader = index("vel_n_m_s"), index("next_1_pos_n_m")
        self._leader_vel, self._age = index("next_1_vel_n_m_s"), index("next_1_beacon_age_s")
        self._from_leader_ned_m, self._weights = np.asarray(from_leader_ned_m), np.asarray(weights)

    def __call__(self, observation: Floats) -> Doubles:
        """Return the action (3,) for an observation."""
        leader_vel = observation[self._leader_vel : self._leader_vel + 3]
        vectors = (
            observation[self._leader : self._leader + 3] + self._from_leader_ned_m,
            leader_vel,
            leader_vel * observation[self._age],
            observation[self._vel : self._vel + 3],
        )
        velocity = self._weights @ np.array(vectors)
        return np.clip(velocity / SPEED_MAX_M_S, -1.0, 1.0)

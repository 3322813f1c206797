"""Policies of both UAVs, functions of observations: the leader's is given, the follower's is searched."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]

SPEED_MAX_M_S = 3.0
RADIUS_M, LEADER_M_S = 6.0, 2.0


def lead(observation: Floats) -> Doubles:
    """Return the leader's action (3,): velocity along a circle of `RADIUS_M` whose south is its place."""
    north_m, east_m, down_m = observation[:3]  # its place from it
    from_centre = np.array([-north_m - RADIUS_M, -east_m])
    distance_m = max(np.linalg.norm(from_centre), 0.1)
    outward = from_centre / distance_m
    velocity = LEADER_M_S * np.array([-outward[1], outward[0]]) + (RADIUS_M - distance_m) * outward
    return np.array([*velocity, down_m]) / SPEED_MAX_M_S


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

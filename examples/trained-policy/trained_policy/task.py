"""The task: UAV 0 flies a circle in gusty wind, UAV 1 keeps its place beside it, 8.5 m apart.

The follower has the leader's beacons, five a second, and its own position and velocity estimates. Each GPS
receiver has errors of its own, of a metre and more.
"""

import numpy as np

import coflight.env
from coflight.env import EnvState, UavEnv
from trained_policy.policies import SPEED_MAX_M_S, Doubles, lead

DURATION_S = 10.0
OVERRIDES = ["formation.rows=1", "formation.columns=2"]


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

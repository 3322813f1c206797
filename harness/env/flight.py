"""What both environments are made of: episodes of one swarm as arrays, rewards, spaces as bounds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.env.client import Client, env_scenario
from harness.env.messages import Stepped
from harness.env.reward import EnvState, Reward, hold_place, rewards
from harness.env.settings import EnvSettings, checked_action
from harness.launch.run_messages import SwarmError
from harness.scenario.scenario import Scenario

SEEDS = 2**31
"""Number of the seeds that are drawn for episodes without one."""


class EnvFlight:
    """Episodes of one swarm; arguments as those of `coflight.env.parallel_env`."""

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        agents: int | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        duration_s: float = 20.0,
        reward: Reward = hold_place,
        **settings: Any,  # noqa: ANN401  checked by msgspec
    ) -> None:
        try:
            self.settings = msgspec.convert(settings, EnvSettings)
        except msgspec.ValidationError as error:
            raise ValueError(f"env: {error}") from None
        if not duration_s > 0.0:
            raise ValueError(f"env: duration_s: {duration_s}; expected greater than 0")
        self.scenario = env_scenario(scenario, self.settings, agents=agents, seed=seed, overrides=overrides)
        self.agents = self.scenario.agents
        self.period_s = self.scenario.onboard.loop_period_us * 1e-6
        self._most_steps = max(1, round(duration_s / self.period_s))
        self._reward = reward
        self._places_ned_m = self.scenario.places_ned_m()
        self._client = Client(self.scenario)
        self._steps = 0
        self.observations = np.zeros((self.agents, len(self.settings.observation_names(self.agents))), "f4")
        """(N, O) after the last reset or step."""
        self.reasons: dict[int, str] = {}
        """Why UAVs have ended in the last step."""

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the swarm's server and of the episode; none before the first reset."""
        return self._client.pids

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return self._steps >= self._most_steps

    def reset(self, seed: int) -> None:
        """Begin an episode; ``seed`` is 0 or greater. Raises SwarmError, CompileError."""
        if seed < 0:
            raise ValueError(f"env: seed: {seed}; expected 0 or greater")
        self._steps = 0
        self._take(self._client.reset(seed))

    def step(self, actions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply actions (N, A), rows of NaN to hold the place; return the rewards (N,).

        Raises SwarmError; ExtensionFailure for the reward.
        """
        stepped = self._client.step(actions)
        self._steps += 1
        pos_vel = self._take(stepped)
        ended = np.zeros(self.agents, np.bool_)
        ended[list(stepped.ended)] = True
        state = EnvState(
            time_s=self._steps * self.period_s, period_s=self.period_s, pos_ned_m=pos_vel[:, :3],
            vel_ned_m_s=pos_vel[:, 3:], places_ned_m=self._places_ned_m, actions=actions,
            observations=self.observations, ended=ended,
        )  # fmt: skip
        return rewards(self._reward, state)

    def no_actions(self) -> NDArray[np.float64]:
        """Return actions (N, A) with which all UAVs hold their places."""
        return np.full((self.agents, len(self.settings.action_names())), np.nan)

    def action(self, name: str, action: ArrayLike) -> NDArray[np.float64]:
        """Return an action (A,) limited to -1 to 1. Raises ValueError for another shape, or NaN."""
        return checked_action(self.settings, name, action)

    def close(self) -> None:
        """End all processes; harmless when repeated."""
        self._client.close()

    def _take(self, stepped: Stepped) -> NDArray[np.float64]:
        """Store observations and reasons; return true positions and velocities (N, 6)."""
        # copies: received bytes are read-only, and users write to observations
        self.observations = np.frombuffer(stepped.observations, "f4").reshape(self.agents, -1).copy()
        self.reasons = stepped.ended
        return np.frombuffer(stepped.truth).reshape(self.agents, 6)


def check_stepped(names: Sequence[str]) -> None:
    """Raise SwarmError if there is no UAV to step."""
    if not names:
        raise SwarmError("env: the episode is over: reset comes before step")

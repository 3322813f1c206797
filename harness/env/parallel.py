"""The environment of PettingZoo: a swarm whose UAVs are agents."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import ArrayLike
from pettingzoo import ParallelEnv

from harness.env.flight import SEEDS, EnvFlight, check_stepped
from harness.env.reward import Reward, hold_place
from harness.env.settings import Floats
from harness.scenario.scenario import Scenario

Observations = dict[str, Floats]
Infos = dict[str, dict[str, Any]]


class SwarmEnv(ParallelEnv[str, Floats, Floats]):
    """A swarm in the air as an environment of PettingZoo; see `coflight.env.parallel_env`.

    Agents are ``uav_0``, ``uav_1``, ...; one that collides, touches the ground or is lost ends, and its
    rotors stop. The info of each agent has the ``seed`` of the episode after `reset`, and the ``reason`` of
    its end.

    Attributes:
        possible_agents: all agents.
        agents: those that are in the air; empty after the episode's end.
        observation_names: names of an observation's elements, with units.
        action_names: names of an action's elements.

    """

    metadata: dict[str, Any] = {"name": "coflight_v0", "render_modes": [], "is_parallelizable": True}  # noqa: RUF012
    render_mode = None

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        agents: int | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        duration_s: float = 20.0,
        reward: Reward = hold_place,
        **settings: Any,  # noqa: ANN401  see `EnvFlight`
    ) -> None:
        self._flight = flight = EnvFlight(
            scenario, agents=agents, seed=seed, overrides=overrides, duration_s=duration_s, reward=reward,
            **settings,
        )  # fmt: skip
        self.possible_agents = [f"uav_{number}" for number in range(flight.agents)]
        self.agents: list[str] = []
        self.observation_names = flight.settings.observation_names(flight.agents)
        self.action_names = flight.settings.action_names()
        low, high = flight.settings.observation_bounds(flight.agents)
        self.observation_spaces: dict[str, Space[Floats]] = {
            name: Box(low, high) for name in self.possible_agents
        }
        self.action_spaces: dict[str, Space[Floats]] = {
            name: Box(-1.0, 1.0, (len(self.action_names),)) for name in self.possible_agents
        }
        self._rng = np.random.default_rng()

    def observation_space(self, agent: str) -> Space[Floats]:
        """Return the space of an agent's observations, in physical units."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Floats]:
        """Return the space of an agent's actions, each element within -1 to 1."""
        return self.action_spaces[agent]

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the swarm's server and of the episode; none before the first `reset`."""
        return self._flight.pids

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  of the interface
    ) -> tuple[Observations, Infos]:
        """Begin an episode: fork the hovering swarm, with the random streams of the seed.

        Without a seed one is drawn; draws continue from the last seed given. ``options`` has no effect.
        The first call flies the swarm to its places. Raises SwarmError, CompileError.
        """
        episode = int(self._rng.integers(SEEDS)) if seed is None else seed
        self._flight.reset(episode)
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self.agents = [*self.possible_agents]
        return self._observations(), {name: {"seed": episode} for name in self.agents}

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Fly one period with actions by agent; an agent without one holds its place.

        Observations are those of the on-board iteration at which the actions take effect: they show the
        effect from the next step on. Rewards are of the state at the period's end. Raises SwarmError,
        ValueError for a wrong action, ExtensionFailure for the reward.
        """
        check_stepped(self.agents)
        flight, values = self._flight, self._flight.no_actions()
        for name, action in actions.items():
            if name not in self.agents:
                raise ValueError(f"env: action of {name!r}; expected one of {', '.join(self.agents)}")
            values[self.possible_agents.index(name)] = flight.action(name, action)
        rewards = flight.step(values).tolist()
        observations = self._observations()
        numbers = {name: self.possible_agents.index(name) for name in self.agents}
        truncated = flight.is_over
        result = (
            observations,
            {name: rewards[i] for name, i in numbers.items()},
            {name: i in flight.reasons for name, i in numbers.items()},
            {name: truncated and i not in flight.reasons for name, i in numbers.items()},
            {name: _info(flight.reasons.get(i)) for name, i in numbers.items()},
        )
        self.agents = [] if truncated else [name for name, i in numbers.items() if i not in flight.reasons]
        return result

    def render(self) -> None:
        """Draw nothing."""

    def close(self) -> None:
        """End all processes; harmless when repeated."""
        self.agents = []
        self._flight.close()

    def _observations(self) -> Observations:
        rows = self._flight.observations
        return {name: rows[self.possible_agents.index(name)] for name in self.agents}


def _info(reason: str | None) -> dict[str, Any]:
    return {} if reason is None else {"reason": reason}

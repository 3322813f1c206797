"""The environment of Gymnasium: one UAV of a swarm."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from harness.env.flight import SEEDS, EnvFlight
from harness.env.reward import Reward, hold_place
from harness.env.settings import Floats
from harness.launch.run_messages import SwarmError
from harness.scenario.scenario import Scenario


class UavEnv(gymnasium.Env[Floats, NDArray[np.float32]]):
    """One UAV of a swarm as an environment of Gymnasium; see `coflight.env.single_env`.

    ``uav`` is its number. The others hold their places, or follow ``others``, a function of an observation
    (O,) that returns an action (A,). The info has the ``seed`` of the episode after `reset`, and the
    ``reason`` of the UAV's end.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | Scenario,
        *,
        uav: int = 0,
        others: Callable[[Floats], ArrayLike] | None = None,
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
        if not 0 <= uav < flight.agents:
            raise ValueError(f"env: uav: {uav}; expected 0 to {flight.agents - 1}")
        self._uav, self._others = uav, others
        self._living: set[int] = set()
        """Others in the air."""
        self._is_flying = False
        self.observation_names = flight.settings.observation_names(flight.agents)
        self.action_names = flight.settings.action_names()
        self.observation_space = Box(*flight.settings.observation_bounds(flight.agents))
        self.action_space = Box(-1.0, 1.0, (len(self.action_names),))

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the swarm's server and of the episode; none before the first `reset`."""
        return self._flight.pids

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode; see `harness.env.parallel.SwarmEnv.reset`."""
        super().reset(seed=seed, options=options)
        episode = int(self.np_random.integers(SEEDS)) if seed is None else seed
        self._flight.reset(episode)
        self._living = set(range(self._flight.agents)) - {self._uav}
        self._is_flying = True
        return self._flight.observations[self._uav], {"seed": episode}

    def step(self, action: ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Fly one period; see `harness.env.parallel.SwarmEnv.step`."""
        if not self._is_flying:
            raise SwarmError("env: the episode is over: reset comes before step")
        flight, values = self._flight, self._flight.no_actions()
        values[self._uav] = flight.action(f"uav_{self._uav}", action)
        if self._others is not None:
            for i in self._living:
                values[i] = flight.action(f"uav_{i}", self._others(flight.observations[i]))
        reward = float(flight.step(values)[self._uav])
        self._living -= flight.reasons.keys()
        reason = flight.reasons.get(self._uav)
        truncated = flight.is_over and reason is None
        self._is_flying = reason is None and not truncated
        info = {} if reason is None else {"reason": reason}
        return flight.observations[self._uav], reward, reason is not None, truncated, info

    def close(self) -> None:
        """End all processes; harmless when repeated."""
        self._is_flying = False
        self._flight.close()

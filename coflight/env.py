"""Environments for learning and search, with PettingZoo's and Gymnasium's interfaces: ``coflight[env]``.

import coflight.env

env = coflight.env.parallel_env("article", agents=4, duration_s=10.0)
observations, infos = env.reset(seed=1)
while env.agents:
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
env.close()
"""

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.kernels import cache_folder

os.environ.update(cache_folder.environment())  # read when numba is imported, which is next

from harness.env.reward import EnvState, Reward, hold_place
from harness.env.settings import Floats
from harness.scenario.scenario import Scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from harness.env.parallel import SwarmEnv
    from harness.env.single import UavEnv

__all__ = ["EnvState", "SwarmEnv", "UavEnv", "hold_place", "parallel_env", "single_env"]
_CLASSES = {"SwarmEnv": "harness.env.parallel", "UavEnv": "harness.env.single"}
"""Modules of the environments' classes, for annotations; `parallel_env` and `single_env` create them."""
_LACKS = "coflight.env: {} is not installed; install coflight with its extra: pip install 'coflight[env]'"


def parallel_env(
    scenario: "str | Path | Scenario",
    *,
    agents: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
    duration_s: float = 20.0,
    reward: Reward = hold_place,
    **settings: Any,  # noqa: ANN401  fields of harness.env.settings.EnvSettings
) -> "SwarmEnv":
    """Return an environment of PettingZoo (`ParallelEnv`) whose agents are the UAVs of a scenario.

    An episode begins with all UAVs in the air at the scenario's places. A step is one period of the on-board
    loop (``onboard.loop_period_ms``, 40 ms); observations are those that the on-board application has.

    Args:
        scenario: File, name of a packaged scenario, or Scenario; ``agents``, ``seed`` and ``overrides``
            change it as those of `Swarm`. Its own application is replaced; ``[[onboard.programs]]`` fly too.
        agents: Number of UAVs.
        seed: Seed of the flight to the places, which all episodes share.
        overrides: Scenario fields, such as ``"wind.mean_n=2"``.
        duration_s: Simulated time after which an episode is truncated.
        reward: Function of an `EnvState` that returns one number for each UAV.
        **settings: ``setpoint`` ("velocity" or "acceleration"), ``speed_max_m_s``, ``acc_max_m_s2``,
            ``message_size``, ``radio`` ("scheduled" or "chosen"), ``beacon_period_s``, ``range_period_s``.

    Raises ValueError, ScenarioError for wrong settings; ImportError without the extra ``env``.
    """
    kind: type[SwarmEnv] = _load("SwarmEnv")
    return kind(
        scenario, agents=agents, seed=seed, overrides=overrides, duration_s=duration_s, reward=reward,
        **settings,
    )  # fmt: skip


def single_env(
    scenario: "str | Path | Scenario",
    *,
    uav: int = 0,
    others: "Callable[[Floats], ArrayLike] | None" = None,
    agents: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
    duration_s: float = 20.0,
    reward: Reward = hold_place,
    **settings: Any,  # noqa: ANN401  as above
) -> "UavEnv":
    """Return an environment of Gymnasium (`Env`) for one UAV of a scenario; arguments as of `parallel_env`.

    Args:
        uav: Number of the UAV.
        others: Policy of the other UAVs, from an observation (O,) to an action (A,); None: they hold their
            places.

    """
    kind: type[UavEnv] = _load("UavEnv")
    return kind(
        scenario, uav=uav, others=others, agents=agents, seed=seed, overrides=overrides,
        duration_s=duration_s, reward=reward, **settings,
    )  # fmt: skip


def __getattr__(name: str) -> object:
    """Load a class of environments. Raises AttributeError; ImportError without the extra ``env``."""
    if name not in _CLASSES:
        raise AttributeError(f"module 'coflight.env' has no attribute {name!r}")
    return _load(name)


def _load(name: str) -> Any:  # noqa: ANN401  a class of an optional extra
    try:
        return getattr(import_module(_CLASSES[name]), name)
    except ModuleNotFoundError as error:
        raise _lacking(error) from None


def _lacking(error: ModuleNotFoundError) -> ModuleNotFoundError:
    """Return the error in words, if it is the extra that is not installed."""
    package = (error.name or "").partition(".")[0]
    if package in {"pettingzoo", "gymnasium"}:
        return ModuleNotFoundError(_LACKS.format(package), name=package)
    return error

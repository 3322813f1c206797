"""A swarm that flies to its places, and then follows actions: the simulation behind an environment."""

import os
from functools import partial

import msgspec
import numpy as np
from numpy.typing import NDArray

from foundation.extension_failure import ExtensionFailure
from harness.env.application import EnvApplication
from harness.env.messages import Stepped
from harness.env.reseed import RandomStreams
from harness.env.settings import EnvSettings, limited
from harness.launch.in_process_flight import InProcessFlight
from harness.launch.process_commands import uav
from harness.launch.run_messages import SwarmError
from harness.records.run_folder import PhysicsConfig
from harness.scenario.scenario import Scenario
from harness.simulator.messages import Collision, VehicleLost
from netsim.model.config import ServerConfig

RUN_ID = "env"
HOVER_LIMIT_S = 120.0
"""Simulated time within which all UAVs must hover at their places."""
HOVER_S = 2.0
"""Time for which they must."""
GROUND_M = 0.1
"""A UAV whose centre of mass is lower than on the ground plus this has touched it."""


class Episode:
    """One swarm in this process: `hover`, then `begin` with a seed, usually in a fork, then `step`.

    ``scenario`` is one of `harness.env.client.env_scenario`. Raises ValueError and ExtensionError for
    settings that cannot be used.
    """

    def __init__(self, scenario: Scenario, settings: EnvSettings) -> None:
        self.agents = scenario.agents
        self._period_us = scenario.onboard.loop_period_us
        self._steps = self._period_us // scenario.run.step_us
        self._bounds = settings.observation_bounds(scenario.agents)
        self._ground_m = np.array([each.standing_height_m for each in scenario.airframes()]) + GROUND_M
        self._ended: dict[int, str] = {}
        """Reasons of all UAVs that have ended."""
        physics = PhysicsConfig(
            run_id=RUN_ID, scenario=scenario, truth_log_path=os.devnull, air_log_path=os.devnull,
            event_log_path=os.devnull,
        )  # fmt: skip
        radio = ServerConfig(
            run_id=RUN_ID, stations=scenario.agents, seed=scenario.run.seed, radio=scenario.radio,
            uwb=scenario.uwb_radios,
        )  # fmt: skip
        vehicle = partial(scenario.vehicle_config, run_id=RUN_ID, radio_endpoint=None, log_path=None)
        self._flight = InProcessFlight(
            physics, radio, [vehicle(i) for i in range(scenario.agents)], emit=self._on_event,
            on_failure=self._on_failure,
        )  # fmt: skip
        self._applications: list[EnvApplication] = []
        for link in self._flight.links:
            programs = link.host.vehicle.app
            if programs is None or not isinstance(programs.application, EnvApplication):
                raise TypeError("the scenario's application is not that of an environment")
            self._applications.append(programs.application)
        self._streams: RandomStreams | None = None

    @property
    def time_us(self) -> int:
        """Simulated time of the next step."""
        return self._flight.simulation.time_us

    def hover(self) -> None:
        """Fly all UAVs to their places. Raises SwarmError unless all arrive in time."""
        simulation = self._flight.simulation
        while simulation.time_us % self._period_us:
            simulation.step()
        hovering = 0
        while hovering * self._period_us < HOVER_S * 1e6:
            self._advance()
            if self._ended:
                raise SwarmError("; ".join(f"{uav(number)}: {text}" for number, text in self._ended.items()))
            late = [i for i, each in enumerate(self._applications) if not each.is_hovering]
            hovering = 0 if late else hovering + 1
            if late and simulation.time_us > HOVER_LIMIT_S * 1e6:
                raise SwarmError(
                    f"{uav(late[0])} does not hover at its place after {HOVER_LIMIT_S:g} s of simulated time"
                )
        self._streams = RandomStreams()

    def begin(self, seed: int) -> Stepped:
        """Reseed all random streams, hover for one period, and return the state."""
        if self._streams is None:
            raise RuntimeError("hover comes first")
        self._streams.reseed(seed)
        return self.step(np.full((self.agents, 1), np.nan))

    def step(self, actions: NDArray[np.float64]) -> Stepped:
        """Apply actions (N, A) for one period, and return the state after it.

        Observations are those of the applications' iteration at the period's begin, in which the actions
        take effect.
        """
        for application, action in zip(self._applications, actions, strict=True):
            application.action = action
        before = set(self._ended)
        self._advance()
        true = self._flight.simulation.truth
        for number, application in enumerate(self._applications):
            if -true.pos_ned_m[number, 2] < self._ground_m[number]:
                self._ended.setdefault(number, "touched the ground")
            elif not application.follows:
                self._ended.setdefault(number, "the autopilot does not follow setpoints any more")
        ended = {number: text for number, text in self._ended.items() if number not in before}
        for number in ended:
            self._flight.links[number].killed = True
        rows = np.array([each.observation() for each in self._applications])
        observations = limited(rows, self._bounds)
        truth = np.hstack((true.pos_ned_m, true.vel_ned_m_s))
        return Stepped(self.time_us, observations.tobytes(), truth.tobytes(), ended)

    def close(self) -> None:
        """End the flight."""
        self._flight.close()

    def _advance(self) -> None:
        for _ in range(self._steps):
            self._flight.simulation.step()

    def _on_event(self, name: str, event: msgspec.Struct) -> None:  # noqa: ARG002  the event has its vehicles
        match event:
            case Collision(first=first, second=second):
                self._ended.setdefault(first, f"collided with {uav(second)}")
                self._ended.setdefault(second, f"collided with {uav(first)}")
            case VehicleLost(instance=instance, reason=reason):
                self._ended.setdefault(instance, reason)

    def _on_failure(self, name: str, failure: ExtensionFailure) -> None:
        self._ended.setdefault(int(name.rsplit(maxsplit=1)[-1]), str(failure))

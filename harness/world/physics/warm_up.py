"""Runs every numerical kernel of the physics and the sensors once, so that all are compiled and on disk."""

import numpy as np

from autopilot.parameters.config import Site
from foundation.airframe.files import IRIS
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.hil import SensorEncoder
from harness.world.physics.environment import EnvironmentConfig
from harness.world.physics.world import World
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import SensorSuite
from harness.world.wind import Wind, WindConfig

STEPS = 100
_STEP_US = 4_000


def warm_up() -> None:
    """Simulate the lift-off of two vehicles with sensors and HIL messages for a fraction of a second."""
    ActuatorInbox(2, len(IRIS.rotors)).unpack(0)
    spawn_ned_m = np.array([[0.0, 0.0, -IRIS.standing_height_m], [0.0, 5.0, -IRIS.standing_height_m]])
    vehicles, encoder = len(spawn_ned_m), SensorEncoder()
    sensors = SensorSuite(
        config=SensorsConfig(),
        site=Site(),
        vehicles=vehicles,
        step_us=_STEP_US,
        seed=np.random.SeedSequence(0),
    )
    with World(
        airframes=[IRIS] * vehicles,
        spawn_pos_ned_m=spawn_ned_m,
        spawn_yaw_rad=0.0,
        step_us=_STEP_US,
        environment=EnvironmentConfig(ground_effect=True),
    ) as world:
        forces, turbulent_air = (
            Wind(config, vehicles, np.random.default_rng(0), formation_height_m=10.0)
            for config in (WindConfig(), WindConfig(kind="velocity", turbulence="dryden"))
        )
        dt_s, height_m = _STEP_US * 1e-6, np.full(vehicles, 1.0)
        for step in range(STEPS):
            encoder.encode(step * _STEP_US, sensors.sample(step * _STEP_US, world.truth))
            world.vehicle_contacts  # noqa: B018  compiles the search for contacts
            world.step(
                np.full((vehicles, len(IRIS.rotors)), 0.8),
                np.ones(vehicles, dtype=bool),
                forces.step(dt_s, time_us=step * _STEP_US, height_m=height_m).force_ned_n,
                air_vel_ned_m_s=turbulent_air.step(
                    dt_s, time_us=step * _STEP_US, height_m=height_m
                ).air_vel_ned_m_s,
            )

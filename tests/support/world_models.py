"""Sensors and faults of a scenario for vehicles in given states."""

import numpy as np
from world_truth import truth_with

from autopilot.parameters.config import Site
from foundation.airframe.files import IRIS
from harness.world.interfaces import inputs_of
from harness.world.obstacles import Obstacles
from harness.world.sensors.config import ExtraSensor
from harness.world.user_models import WorldModels

STEP_US = 4_000
LEVEL = (1.0, 0.0, 0.0, 0.0)


def models(vehicles=3, boxes=(), seed=1):
    return WorldModels(
        seed=seed, stream=250, airframes=[IRIS] * vehicles, site=Site(), obstacles=Obstacles(boxes),
        step_us=STEP_US,
    )  # fmt: skip


def truth_of(pos_ned_m, q_ned_frd=LEVEL):
    n = len(pos_ned_m)
    return truth_with(
        pos_ned_m=np.array(pos_ned_m, float), vel_ned_m_s=np.zeros((n, 3)),
        q_ned_frd=np.tile(q_ned_frd, (n, 1)),
        omega_frd_rad_s=np.zeros((n, 3)), acc_ned_m_s2=np.zeros((n, 3)), rotor_speed_rad_s=np.zeros((n, 4)),
        specific_force_frd_m_s2=np.zeros((n, 3)), mean_omega_frd_rad_s=np.zeros((n, 3)),
    )  # fmt: skip


def state_of(pos_ned_m, vehicle=0, q_ned_frd=LEVEL, time_us=STEP_US, lost=()):
    """Return the inputs of a vehicle among those at positions (n, 3), all with the same attitude."""
    alive = np.ones(len(pos_ned_m), bool)
    alive[list(lost)] = False
    return inputs_of(time_us, truth_of(pos_ned_m, q_ned_frd), alive, vehicle, 4)


def sensor_of(model, settings=None, *, number=0, vehicle=0, name="", **world):
    choice = ExtraSensor(model=model, settings=settings or {}, name=name)
    return models(**world).sensor(choice, number, vehicle)

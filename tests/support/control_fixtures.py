"""Closed loops of the controllers over the independent 6-DOF Iris, with gusts."""

import math

import numpy as np

from autopilot.control import ControlParams, FlightController
from foundation.types import Array, AttitudeSetpoint, TrajectorySetpoint
from studies.vehicle.rigid_body import DT_S, Iris, estimate

__all__ = ["DT_S", "Gusts", "Iris", "estimate", "fly", "hover_errors"]


class Gusts:
    """Mean force at 45 degrees plus first-order Gauss-Markov gusts per axis (tau 2 s, vertical 0.3)."""

    def __init__(self, *, mean_n: float, gust_rms_n: float, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._mean = mean_n * np.array((math.sqrt(0.5), math.sqrt(0.5), 0.0))
        self._rms = gust_rms_n * np.array((1.0, 1.0, 0.3))
        self._decay = math.exp(-DT_S / 2.0)
        self._gust = self._rms * self._rng.standard_normal(3)

    def force_ned_n(self) -> Array:
        innovation = math.sqrt(1.0 - self._decay**2) * self._rms
        self._gust = self._decay * self._gust + innovation * self._rng.standard_normal(3)
        return self._mean + self._gust


def hover_errors(
    params: ControlParams,
    *,
    mean_n: float,
    gust_rms_n: float,
    seed: int,
    seconds: float,
    settle_s: float = 10.0,
) -> Array:
    """Return NED position errors (n, 3) of a hover at 5 m height, after ``settle_s``, with sensor noise."""
    iris = Iris(height_m=5.0, noise_seed=seed + 1000)
    gusts = Gusts(mean_n=mean_n, gust_rms_n=gust_rms_n, seed=seed)
    controller = FlightController(params)
    setpoint = TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -5.0)), yaw_rad=0.0)
    errors = []
    for k in range(round((seconds + settle_s) / DT_S)):
        iris.step(fly(controller, iris, setpoint), gusts.force_ned_n())
        if k * DT_S >= settle_s:
            errors.append(iris.pos_ned_m - (0.0, 0.0, -5.0))
    return np.array(errors)


def fly(
    controller: FlightController,
    iris: Iris,
    setpoint: TrajectorySetpoint | AttitudeSetpoint,
    *,
    landed: bool = False,
) -> Array:
    return np.array(controller.update(iris.estimate(), setpoint, dt_s=DT_S, landed=landed))

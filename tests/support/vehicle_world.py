"""One whole `Vehicle` with the real physics, sensors and simulator messages, in one process."""

import numpy as np

from autopilot.parameters.config import AutopilotConfig, VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from studies.vehicle.solo import STEP_US, Solo

__all__ = ["STEP_US", "Flight", "vehicle_config"]


def vehicle_config(*, onboard: bool = False, params: dict[str, float] | None = None) -> VehicleConfig:
    return VehicleConfig(
        run_id="test",
        instance=0,
        seed=7,
        onboard=OnboardConfig(enabled=onboard, localisation="gps"),
        autopilot=AutopilotConfig(params=params or {}),
        places_ned_m=((0.0, 0.0, -5.0),),
    )


class Flight(Solo):
    """An Iris with consumer-grade sensors in calm air; always the same one."""

    def __init__(self, config: VehicleConfig, *, gps: bool = True) -> None:
        super().__init__(config, seed=np.random.SeedSequence(3), spawn_yaw_rad=0.5, recording=False)
        self.gps = gps

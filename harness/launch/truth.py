"""True states of all vehicles of a swarm at one instant of simulated time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.simulator.messages import VehicleTruth


@dataclass(frozen=True, slots=True, kw_only=True)
class SwarmTruth:
    """N vehicles at ``time_us``. World frame: NED from the site's origin; body frame: FRD."""

    time_us: int
    vehicles: tuple[VehicleTruth, ...]

    @property
    def t_s(self) -> float:
        """Simulated time since the start, seconds."""
        return self.time_us * 1e-6

    @property
    def alive(self) -> NDArray[np.bool_]:
        """(N,) False for a vehicle that was lost: its process ended or was given up."""
        return np.array([vehicle.alive for vehicle in self.vehicles])

    @property
    def pos_ned_m(self) -> Array:
        """Position, (N, 3)."""
        return np.array([vehicle.pos_ned_m for vehicle in self.vehicles])

    @property
    def vel_ned_m_s(self) -> Array:
        """Velocity over ground, (N, 3)."""
        return np.array([vehicle.vel_ned_m_s for vehicle in self.vehicles])

    @property
    def q_ned_frd(self) -> Array:
        """(N, 4) Hamilton, wxyz, FRD to NED."""
        return np.array([vehicle.q_ned_frd for vehicle in self.vehicles])

    @property
    def height_m(self) -> Array:
        """(N,) above the ground at the site's origin."""
        return -self.pos_ned_m[:, 2]

    @property
    def error_m(self) -> Array:
        """(N,) horizontal distance of each vehicle from its place in the formation."""
        return np.array([vehicle.error_m for vehicle in self.vehicles])

"""What the simulation requires of a physics engine; consumer: `harness.simulator.simulation`."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.airframe.description import Airframe
from foundation.types import Array
from harness.world.physics.environment import EnvironmentConfig
from harness.world.physics.truth import Contact, Truth


class Physics(Protocol):
    """n vehicles over flat ground, advanced in fixed steps; `harness.world.physics.world.World` is built in.

    Call order: in each step the properties are read, then `step` is called once; `close` at the end. Before
    the first step the properties hold the spawned state. The engine has no clock and uses no randomness:
    equal arguments give equal bytes. Frames: NED from the site's origin, FRD of the body.
    """

    def step(
        self,
        controls: Array,
        armed: NDArray[np.bool_],
        wind_force_ned_n: Array,
        *,
        rotors_stopped: NDArray[np.bool_] | None = None,
        air_vel_ned_m_s: Array | None = None,
        rotor_effectiveness: Array | None = None,
    ) -> None:
        """Advance by one step with everything held over it.

        R is the greatest number of rotors of a vehicle; elements beyond a vehicle's own have no meaning.
        ``controls`` (n, R): motors, 0..1 in the order of the airframe's rotors; ``armed`` (n,);
        ``wind_force_ned_n`` (n, 3) in N at the centres of mass; ``rotors_stopped`` (n,) or (n, R): rotors
        that run down whatever the controls are; ``air_vel_ned_m_s`` (n, 3) in m/s, None for air at rest;
        ``rotor_effectiveness`` (n, R): remaining part of each rotor's thrust and torques, 0..1, None for
        intact rotors.
        """

    @property
    def truth(self) -> Truth:
        """State of all vehicles at the end of the last step."""

    @property
    def density_ratio(self) -> Array:
        """(n,) air density over the standard density at sea level, in the last step."""

    @property
    def vehicle_contacts(self) -> tuple[Contact, ...]:
        """Pairs of vehicles that touched in the last step, in order of their numbers, each pair once."""

    def close(self) -> None:
        """Free the engine's memory. May be called again."""


class PhysicsFactory(Protocol):
    """Creates the engine of a run."""

    def __call__(
        self,
        *,
        airframes: Sequence[Airframe],
        spawn_pos_ned_m: ArrayLike,
        spawn_yaw_rad: float,
        step_us: int,
        environment: EnvironmentConfig,
        ground_altitude_m: float,
    ) -> Physics:
        """Return an engine with n vehicles, at rest and level.

        ``airframes`` (n): one for each vehicle; ``spawn_pos_ned_m`` (n, 3): centres of mass;
        ``spawn_yaw_rad``: heading, clockwise from north; ``step_us``: length of a step in us;
        ``ground_altitude_m``: ground above mean sea level. Raises ValueError for a spawn below the ground.
        """

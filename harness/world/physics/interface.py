"""What the simulation requires of a physics engine."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.physics.truth import Contact, Truth


class Physics(Protocol):
    """n vehicles over flat ground, advanced in fixed steps; `harness.world.physics.world.World` is built in.

    It uses no randomness: equal arguments give equal bytes. Frames: NED from the site's origin, FRD of the
    body.
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

        ``controls`` (n, 4): motors, 0..1 in PX4's order; ``armed`` (n,); ``wind_force_ned_n`` (n, 3) in N at
        the centres of mass; ``rotors_stopped`` (n,) or (n, 4): rotors that run down whatever the controls
        are; ``air_vel_ned_m_s`` (n, 3) in m/s, None for air at rest; ``rotor_effectiveness`` (n, 4):
        remaining part of each rotor's thrust and torques, 0..1, None for intact rotors.
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

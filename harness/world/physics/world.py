"""The physical world: rigid bodies, contacts and the rotor model.

Bullet (`harness.world.physics.bullet`) steps vehicles near the ground or near each other; the others are
stepped with the same scheme by `harness.world.physics.free_flight`. Forces are those of
`harness.world.physics.rotors`.
"""

import math
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.airframe.description import GRAVITY_M_S2, Airframe
from foundation.types import Array
from harness.world.physics.bodies import BODY
from harness.world.physics.bullet import NO_TOUCHES, Bullet, Touches
from harness.world.physics.environment import STANDARD, EnvironmentConfig
from harness.world.physics.rotors import kernel_model, most_rotors
from harness.world.physics.stepping import StepModel, finish_step, fly
from harness.world.physics.truth import TRUTH, Contact, Truth

REACH_DIAGONALS = 2.0
"""Distance between two vehicles, in diagonals of the largest vehicle's shape, within which Bullet steps them;
half of it is the height above the ground. Vehicles touch within one diagonal, and Bullet searches contacts at
the positions at the begin of a step, so it holds every body with a contact at any speed."""
RELEASE_RATIO = 1.25
"""Bullet releases a vehicle at this multiple of the distance, a hysteresis for vehicles that hover at the
limit."""


class World:
    """Vehicles over flat ground (down = 0), advanced in fixed steps.

    The arguments are those of `harness.world.physics.interface.PhysicsFactory`; landed vehicles spawn
    ``standing_height_m`` of their airframe above the ground. Instances are independent.
    """

    def __init__(
        self,
        *,
        airframes: Sequence[Airframe],
        spawn_pos_ned_m: ArrayLike,
        spawn_yaw_rad: float,
        step_us: int,
        environment: EnvironmentConfig = STANDARD,
        ground_altitude_m: float = 0.0,
    ) -> None:
        spawn = np.array(spawn_pos_ned_m, dtype=np.float64).reshape(-1, 3)
        for vehicle, (airframe, (_, _, down_m)) in enumerate(zip(airframes, spawn.tolist(), strict=True)):
            if down_m > -airframe.standing_height_m + 1e-9:
                raise ValueError(
                    f"vehicle {vehicle} spawns with its centre {down_m:g} m down, "
                    f"but it stands at {-airframe.standing_height_m:g} m"
                )
        diagonal_m = max(math.dist(airframe.body.size_m, (0.0, 0.0, 0.0)) for airframe in airframes)
        step_s = step_us * 1e-6
        self._model = StepModel(
            rotors=kernel_model(airframes, step_s=step_s, ground_effect=environment.ground_effect),
            inertia_kg_m2=np.array([airframe.inertia_kg_m2 for airframe in airframes]),
            mass_kg=np.array([airframe.mass_kg for airframe in airframes]),
            gravity_m_s2=GRAVITY_M_S2,
            step_s=step_s,
            reach_m=REACH_DIAGONALS * diagonal_m,
            release_ratio=RELEASE_RATIO,
        )
        self._environment = environment
        self._ground_altitude_m = ground_altitude_m

        vehicles, rotors = len(spawn), most_rotors(airframes)
        self._air_at_rest = np.zeros((vehicles, 3))
        self._whole_rotors = np.ones((vehicles, rotors))
        self._none_stopped = np.zeros((vehicles, rotors), dtype=np.bool_)
        self.density_ratio = np.ones(vehicles)
        """(n,) air density over `SEA_LEVEL_DENSITY_KG_M3` in the last step."""
        self._applied = np.empty((vehicles, 2, 3))
        self._bodies = np.zeros(vehicles, BODY)
        self._bodies["pos_ned_m"] = spawn
        self._bodies["q_ned_frd"] = math.cos(spawn_yaw_rad / 2.0), 0.0, 0.0, math.sin(spawn_yaw_rad / 2.0)
        self._near = np.zeros(vehicles, dtype=np.bool_)
        """Vehicles that Bullet steps."""
        self._bullet = Bullet(airframes, step_s=step_s, gravity_m_s2=GRAVITY_M_S2)
        self._touches: Touches | None = NO_TOUCHES
        """Contacts of the last step; None: not queried yet."""
        rows = np.zeros(vehicles, TRUTH)
        if finish_step(self._model, self._bodies, self._bodies, self._near, rows):
            self._hand_over()
        self.truth = Truth(rows, np.zeros((vehicles, rotors)))
        """State of all vehicles at the end of the last step."""

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
        """Advance by one step with constant inputs: see `harness.world.physics.interface.Physics`."""
        before = self._bodies
        if self._environment.density != "standard":
            height_m = -before["pos_ned_m"][:, 2]
            self.density_ratio = self._environment.density_ratio(self._ground_altitude_m + height_m)
        if rotors_stopped is None:
            rotors_stopped = self._none_stopped
        elif rotors_stopped.ndim == 1:
            rotors_stopped = np.repeat(rotors_stopped[:, None], self._none_stopped.shape[1], axis=1)
        after, rows = np.empty_like(before), np.empty(len(before), TRUTH)
        if rotor_effectiveness is None:
            rotor_effectiveness = self._whole_rotors
        if air_vel_ned_m_s is None:
            air_vel_ned_m_s = self._air_at_rest
        rotor_speed_rad_s = np.empty_like(self._whole_rotors)
        changed = fly(
            self._model, before, self.truth.rotor_speed_rad_s, controls, armed, rotors_stopped,
            rotor_effectiveness, wind_force_ned_n, air_vel_ned_m_s, self.density_ratio, self._near,
            self._applied, after, rotor_speed_rad_s, rows,
        )  # fmt: skip
        if self._bullet.holds:
            self._bullet.step(before, self._applied, after)
            changed = finish_step(self._model, before, after, self._near, rows)
        self._bodies, self.truth, self._touches = after, Truth(rows, rotor_speed_rad_s), None
        if changed:
            self._hand_over()

    def _hand_over(self) -> None:
        """Add vehicles to Bullet that are near something, and remove the others."""
        held = self._bullet.holds
        for vehicle, near in enumerate(self._near.tolist()):
            if near and vehicle not in held:
                self._bullet.hold(vehicle, self._bodies[vehicle])
            elif not near and vehicle in held:
                self._bullet.release(vehicle)

    @property
    def vehicle_contacts(self) -> tuple[Contact, ...]:
        """Pairs of vehicles that touched in the last step, sorted by their numbers, each pair once."""
        if len(self._bullet.holds) < 2:
            return ()
        return tuple(
            Contact(first=first, second=second, pos_ned_m=pos_ned_m)
            for (first, second), pos_ned_m in sorted(self._last_touches().pairs.items())
        )

    @property
    def on_ground(self) -> NDArray[np.bool_]:
        """(n,) whether each vehicle touched the ground in the last step."""
        on_ground = np.zeros(len(self._bodies), dtype=np.bool_)
        on_ground[list(self._last_touches().ground)] = True
        return on_ground

    def close(self) -> None:
        """Free Bullet's world; harmless when repeated."""
        self._bullet.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _last_touches(self) -> Touches:
        """Return Bullet's contacts of the last step, queried once and on demand."""
        if self._touches is None:
            self._touches = self._bullet.touches()
        return self._touches

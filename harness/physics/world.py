"""The world in which the vehicles move: PyBullet's rigid bodies and contacts under our rotor model.

The only import of pybullet. Bullet integrates and collides; forces come from `harness.physics.rotors`.
"""

import math
from types import TracebackType
from typing import Self

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray

from autopilot.types import Array
from harness.physics.bodies import BODY, any_two_within, observe
from harness.physics.environment import STANDARD, EnvironmentConfig
from harness.physics.loads import loads
from harness.physics.model import VehicleModel
from harness.physics.rotors import kernel_model
from harness.physics.truth import TRUTH, Contact, Truth

GRAVITY_M_S2 = 9.8066
"""As Gazebo-classic's worlds have it."""
GROUND_HALF_WIDTH_M = 10_000.0
SOLVER_RESIDUAL = 1e-16
"""Squared change of the contact impulses at which Bullet stops iterating. At its default of 1e-7 a standing
vehicle creeps by 30 um/s; at this it stays within 1 nm/s, and still stops before its 50 iterations."""

REACH_DIAGONALS = 2.0
"""Distance between two vehicles, in diagonals of their shape, from which on they cannot have touched: they do
so at one at most, and would have to leave each other at hundreds of metres a second to be that far apart when
the step ends."""

_CONTACT_BODY_A, _CONTACT_BODY_B, _CONTACT_POS_ON_A, _CONTACT_DISTANCE, _CONTACT_FORCE = 1, 2, 5, 8, 9


class World:
    """Vehicles of one model over flat ground (down = 0), advanced in fixed steps.

    ``spawn_pos_ned_m`` (n, 3) are the centres of mass, which stand ``model.standing_height_m`` above the
    ground; ``spawn_yaw_rad`` is everyone's heading, clockwise from north. Raises ValueError for a spawn below
    the ground. ``ground_altitude_m`` is that of the ground above mean sea level, for the density. Instances
    are independent of each other and use no randomness: equal arguments give equal bytes.
    """

    def __init__(
        self,
        *,
        model: VehicleModel,
        spawn_pos_ned_m: ArrayLike,
        spawn_yaw_rad: float,
        step_us: int,
        environment: EnvironmentConfig = STANDARD,
        ground_altitude_m: float = 0.0,
    ) -> None:
        spawn = np.array(spawn_pos_ned_m, dtype=np.float64).reshape(-1, 3)
        below = np.flatnonzero(spawn[:, 2] > -model.standing_height_m + 1e-9)
        if below.size:
            raise ValueError(
                f"vehicle {below[0]} spawns with its centre {spawn[below[0], 2]:g} m down, "
                f"but it stands at {-model.standing_height_m:g} m"
            )
        self._step_s = step_us * 1e-6
        self._inertia_kg_m2 = np.array(model.inertia_diagonal_kg_m2)
        self._kernel_model = kernel_model(model, step_s=self._step_s, ground_effect=environment.ground_effect)
        self._environment = environment
        self._ground_altitude_m = ground_altitude_m
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._vehicle_of_body: dict[int, int] = {}
        self._fill_world(model, spawn, spawn_yaw_rad)

        vehicles = len(spawn)
        self._air_at_rest = np.zeros((vehicles, 3))
        self._whole_rotors = np.ones((vehicles, 4))
        self._density_ratio = np.ones(vehicles)
        self._reach_m = REACH_DIAGONALS * math.dist(model.box_m, (0.0, 0.0, 0.0))
        self._rotor_speed_rad_s = np.zeros((vehicles, 4))
        self._body_pos_m: list[tuple[float, float, float]] = []
        self._bodies = self._read_bodies()
        self._truth = self._observe(self._bodies, self._bodies)
        self._contacts_read = True
        self._vehicle_contacts: tuple[Contact, ...] = ()
        self._on_ground = np.zeros(vehicles, dtype=np.bool_)

    def _fill_world(self, model: VehicleModel, spawn_pos_ned_m: Array, spawn_yaw_rad: float) -> None:
        client = self._client
        pybullet.setTimeStep(self._step_s, client)
        pybullet.setGravity(0.0, 0.0, GRAVITY_M_S2, client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, solverResidualThreshold=SOLVER_RESIDUAL, physicsClientId=client
        )
        # not a plane: box on box gives all four points of contact at once, so that a landing stays level
        half_extents_m = (GROUND_HALF_WIDTH_M, GROUND_HALF_WIDTH_M, 10.0)
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half_extents_m, physicsClientId=client
        )
        self._ground = pybullet.createMultiBody(
            0.0, shape, basePosition=(0.0, 0.0, 10.0), physicsClientId=client
        )
        pybullet.changeDynamics(
            self._ground, -1, lateralFriction=1.0, restitution=0.0, physicsClientId=client
        )
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[side_m / 2.0 for side_m in model.box_m], physicsClientId=client
        )
        q_xyzw = (0.0, 0.0, math.sin(spawn_yaw_rad / 2.0), math.cos(spawn_yaw_rad / 2.0))
        for vehicle, pos_ned_m in enumerate(spawn_pos_ned_m.tolist()):
            body = pybullet.createMultiBody(
                model.mass_kg, shape, basePosition=pos_ned_m, baseOrientation=q_xyzw, physicsClientId=client
            )
            pybullet.changeDynamics(
                body,
                -1,
                linearDamping=0.0,
                angularDamping=0.0,
                localInertiaDiagonal=model.inertia_diagonal_kg_m2,
                lateralFriction=model.friction,
                restitution=0.0,
                activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
                physicsClientId=client,
            )
            self._vehicle_of_body[body] = vehicle

    def step(
        self,
        controls: Array,
        armed: NDArray[np.bool_],
        wind_force_ned_n: Array,
        *,
        rotors_stopped: NDArray[np.bool_],
        air_vel_ned_m_s: Array | None = None,
        rotor_effectiveness: Array | None = None,
    ) -> None:
        """Advance by one step with everything held over it.

        ``controls`` (n, 4): motors, 0..1 in PX4's order; ``armed`` (n,); ``wind_force_ned_n`` (n, 3) at the
        centres of mass; ``rotors_stopped`` (n,) or (n, 4): vehicles or rotors that run down whatever the
        controls say; ``air_vel_ned_m_s`` (n, 3): the wind as a velocity, None for air at rest;
        ``rotor_effectiveness`` (n, 4): part of its thrust and torques that a rotor still has, None for whole
        ones.
        """
        before = self._bodies
        if self._environment.density != "standard":
            height_m = -before["pos_ned_m"][:, 2]
            self._density_ratio = self._environment.density_ratio(self._ground_altitude_m + height_m)
        if rotors_stopped.ndim == 1:
            rotors_stopped = np.repeat(rotors_stopped[:, None], 4, axis=1)
        self._rotor_speed_rad_s, applied = loads(
            self._kernel_model,
            self._inertia_kg_m2,
            before,
            self._rotor_speed_rad_s,
            controls,
            armed,
            rotors_stopped,
            self._whole_rotors if rotor_effectiveness is None else rotor_effectiveness,
            wind_force_ned_n,
            self._air_at_rest if air_vel_ned_m_s is None else air_vel_ned_m_s,
            self._density_ratio,
            self._step_s,
        )
        client, frame = self._client, pybullet.WORLD_FRAME
        apply_force, apply_torque = pybullet.applyExternalForce, pybullet.applyExternalTorque
        each = zip(self._vehicle_of_body, self._body_pos_m, applied.tolist(), strict=True)
        for body, pos_m, (force_n, torque_n_m) in each:
            apply_force(body, -1, force_n, pos_m, frame, client)
            apply_torque(body, -1, torque_n_m, frame, client)
        pybullet.stepSimulation(client)
        self._bodies = self._read_bodies()
        self._truth = self._observe(before, self._bodies)
        self._contacts_read = False

    @property
    def truth(self) -> Truth:
        """State of all vehicles at the end of the last step."""
        return self._truth

    @property
    def density_ratio(self) -> Array:
        """(n,) density of the air over that of `SEA_LEVEL_DENSITY_KG_M3`, in the last step."""
        return self._density_ratio

    @property
    def vehicle_contacts(self) -> tuple[Contact, ...]:
        """Pairs of vehicles that touched in the last step, in order of their numbers, each pair once."""
        if self._contacts_read or any_two_within(self._bodies, self._reach_m):
            self._read_contacts()
            return self._vehicle_contacts
        return ()

    @property
    def on_ground(self) -> NDArray[np.bool_]:
        """(n,) whether each vehicle touched the ground in the last step."""
        self._read_contacts()
        return self._on_ground

    def close(self) -> None:
        """Free Bullet's world. May be called again."""
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _read_bodies(self) -> NDArray[np.void]:
        """Rows (n,) of `BODY`."""
        client = self._client
        read_pose, read_velocity = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        numbers: list[float] = []
        self._body_pos_m.clear()
        for body in self._vehicle_of_body:
            pos_ned_m, (x, y, z, w) = read_pose(body, client)
            vel_ned_m_s, omega_ned_rad_s = read_velocity(body, client)
            self._body_pos_m.append(pos_ned_m)
            numbers += (*pos_ned_m, w, x, y, z, *vel_ned_m_s, *omega_ned_rad_s)
        return np.array(numbers).view(BODY)

    def _observe(self, before: NDArray[np.void], after: NDArray[np.void]) -> Truth:
        rows = np.empty(len(after), TRUTH)
        rows["rotor_speed_rad_s"] = self._rotor_speed_rad_s
        observe(before, after, GRAVITY_M_S2, self._step_s, rows)
        return Truth(rows)

    def _read_contacts(self) -> None:
        """Ask Bullet, once per step and only if somebody wants to know."""
        if self._contacts_read:
            return
        self._contacts_read = True
        on_ground = np.zeros(len(self._vehicle_of_body), dtype=np.bool_)
        touching: dict[tuple[int, int], tuple[float, float, float]] = {}
        for point in pybullet.getContactPoints(physicsClientId=self._client):
            if point[_CONTACT_DISTANCE] > 0.0 and point[_CONTACT_FORCE] <= 0.0:
                continue  # near enough for Bullet to keep an eye on it, but apart
            bodies = point[_CONTACT_BODY_A], point[_CONTACT_BODY_B]
            pair = sorted(self._vehicle_of_body[body] for body in bodies if body != self._ground)
            if len(pair) == 1:
                on_ground[pair[0]] = True
            else:
                touching.setdefault((pair[0], pair[1]), point[_CONTACT_POS_ON_A])
        self._on_ground = on_ground
        self._vehicle_contacts = tuple(
            Contact(first=first, second=second, pos_ned_m=pos_ned_m)
            for (first, second), pos_ned_m in sorted(touching.items())
        )

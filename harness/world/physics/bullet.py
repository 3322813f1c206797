"""Bullet's world: the ground, and those vehicles that are near it or each other.

The only import of pybullet but for `harness.world.physics.bare`. Bullet integrates and collides; forces are
given.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.physics.model import VehicleModel

GROUND_HALF_WIDTH_M = 10_000.0
SOLVER_RESIDUAL = 1e-16
"""Squared change of the contact impulses at which Bullet stops iterating. At its default of 1e-7 a standing
vehicle creeps by 30 um/s; at this it stays within 1 nm/s, and still stops before its 50 iterations."""

_CONTACT_BODY_A, _CONTACT_BODY_B, _CONTACT_POS_ON_A, _CONTACT_DISTANCE, _CONTACT_FORCE = 1, 2, 5, 8, 9


class Touches(NamedTuple):
    """Who touched what in a step."""

    ground: frozenset[int]
    """Vehicles that touched it"""
    pairs: dict[tuple[int, int], tuple[float, float, float]]
    """Vehicles that touched each other, smaller number first, and a point of contact, NED, in metres"""


NO_TOUCHES = Touches(frozenset(), {})


class Bullet:
    """Vehicles of one model over flat ground (down = 0), those that it is given. Close it.

    Bullet is given NED axes for its world and FRD ones for its bodies.
    """

    def __init__(self, model: VehicleModel, *, step_s: float, gravity_m_s2: float) -> None:
        self._model = model
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._bodies: dict[int, int] = {}
        """Bullet's number of each vehicle that it holds"""
        client = self._client
        pybullet.setTimeStep(step_s, client)
        pybullet.setGravity(0.0, 0.0, gravity_m_s2, client)
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

    @property
    def holds(self) -> Collection[int]:
        """The vehicles that it holds."""
        return self._bodies.keys()

    def hold(self, vehicle: int, body: np.void) -> None:
        """Take a vehicle in, in a state that is a row of `harness.world.physics.bodies.BODY`."""
        client, model = self._client, self._model
        w, x, y, z = body["q_ned_frd"].tolist()
        # a shape goes with its body, so each has its own
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[side_m / 2.0 for side_m in model.box_m], physicsClientId=client
        )
        number = pybullet.createMultiBody(
            model.mass_kg,
            shape,
            basePosition=body["pos_ned_m"].tolist(),
            baseOrientation=(x, y, z, w),
            physicsClientId=client,
        )
        pybullet.changeDynamics(
            number,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            localInertiaDiagonal=model.inertia_diagonal_kg_m2,
            lateralFriction=model.friction,
            restitution=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        pybullet.resetBaseVelocity(
            number, body["vel_ned_m_s"].tolist(), body["omega_ned_rad_s"].tolist(), client
        )
        self._bodies[vehicle] = number

    def release(self, vehicle: int) -> None:
        """Give a vehicle up."""
        pybullet.removeBody(self._bodies.pop(vehicle), self._client)

    def step(self, before: NDArray[np.void], applied: Array, after: NDArray[np.void]) -> None:
        """Move the vehicles that it holds by a step; writes their rows of ``after`` (n,), of `BODY`.

        ``applied`` (n, 2, 3) are force and torque, NED, at the centres of mass, where they are ``before``.
        """
        client, frame = self._client, pybullet.WORLD_FRAME
        for vehicle, body in self._bodies.items():
            force_n, torque_n_m = applied[vehicle].tolist()
            pos_m = before["pos_ned_m"][vehicle].tolist()
            pybullet.applyExternalForce(body, -1, force_n, pos_m, frame, client)
            pybullet.applyExternalTorque(body, -1, torque_n_m, frame, client)
        pybullet.stepSimulation(client)
        for vehicle, body in self._bodies.items():
            pos_ned_m, (x, y, z, w) = pybullet.getBasePositionAndOrientation(body, client)
            vel_ned_m_s, omega_ned_rad_s = pybullet.getBaseVelocity(body, client)
            after[vehicle] = pos_ned_m, (w, x, y, z), vel_ned_m_s, omega_ned_rad_s

    def touches(self) -> Touches:
        """Look who touched what in the last step."""
        vehicles = {body: vehicle for vehicle, body in self._bodies.items()}
        ground: set[int] = set()
        pairs: dict[tuple[int, int], tuple[float, float, float]] = {}
        for point in pybullet.getContactPoints(physicsClientId=self._client):
            if point[_CONTACT_DISTANCE] > 0.0 and point[_CONTACT_FORCE] <= 0.0:
                continue  # near enough for Bullet to keep an eye on it, but apart
            bodies = point[_CONTACT_BODY_A], point[_CONTACT_BODY_B]
            pair = sorted(vehicles[body] for body in bodies if body != self._ground)
            if len(pair) == 1:
                ground.add(pair[0])
            else:
                pairs.setdefault((pair[0], pair[1]), point[_CONTACT_POS_ON_A])
        return Touches(frozenset(ground), pairs)

    def close(self) -> None:
        """Let Bullet go; harmless when repeated."""
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

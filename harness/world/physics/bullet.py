"""Bullet's world: the ground, and the vehicles near it or near each other.

The only import of pybullet in the product. Bullet integrates and handles collisions;
forces are inputs.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from foundation.airframe.description import Airframe
from foundation.types import Array

GROUND_HALF_WIDTH_M = 10_000.0
SOLVER_RESIDUAL = 1e-16
"""Squared change of the contact impulses at which Bullet stops iterating. With its default of 1e-7 a landed
vehicle creeps at 30 um/s; with this value at less than 1 nm/s, still in fewer than 50 iterations."""

_CONTACT_BODY_A, _CONTACT_BODY_B, _CONTACT_POS_ON_A, _CONTACT_DISTANCE, _CONTACT_FORCE = 1, 2, 5, 8, 9


class Touches(NamedTuple):
    """Contacts of a step."""

    ground: frozenset[int]
    """Vehicles that touched the ground"""
    pairs: dict[tuple[int, int], tuple[float, float, float]]
    """Vehicles that touched each other, smaller number first, and a point of contact, NED, in metres"""


NO_TOUCHES = Touches(frozenset(), {})


class Bullet:
    """Vehicles with these airframes over flat ground (down = 0). Close it.

    Bullet's world has NED axes, its bodies FRD axes.
    """

    def __init__(self, airframes: Sequence[Airframe], *, step_s: float, gravity_m_s2: float) -> None:
        self._airframes = tuple(airframes)
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        self._bodies: dict[int, int] = {}
        """Bullet's number of each vehicle"""
        client = self._client
        pybullet.setTimeStep(step_s, client)
        pybullet.setGravity(0.0, 0.0, gravity_m_s2, client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1, solverResidualThreshold=SOLVER_RESIDUAL, physicsClientId=client
        )
        # not a plane: two boxes have all four points of contact at once, so a landing stays level
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
        """The vehicles in Bullet's world."""
        return self._bodies.keys()

    def hold(self, vehicle: int, body: np.void) -> None:
        """Add a vehicle with the state of a row of `harness.world.physics.bodies.BODY`."""
        client, airframe = self._client, self._airframes[vehicle]
        w, x, y, z = body["q_ned_frd"].tolist()
        # removing a body removes its shape, so each has its own
        half_extents_m = [side_m / 2.0 for side_m in airframe.body.size_m]
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half_extents_m, physicsClientId=client
        )
        number = pybullet.createMultiBody(
            airframe.mass_kg,
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
            localInertiaDiagonal=airframe.inertia_kg_m2,
            lateralFriction=airframe.body.friction,
            restitution=0.0,
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        pybullet.resetBaseVelocity(
            number, body["vel_ned_m_s"].tolist(), body["omega_ned_rad_s"].tolist(), client
        )
        self._bodies[vehicle] = number

    def release(self, vehicle: int) -> None:
        """Remove a vehicle."""
        pybullet.removeBody(self._bodies.pop(vehicle), self._client)

    def step(self, before: NDArray[np.void], applied: Array, after: NDArray[np.void]) -> None:
        """Step the vehicles in Bullet's world and write their rows of ``after`` (n,), of `BODY`.

        ``applied`` (n, 2, 3) are force and torque, NED, at the centres of mass of ``before`` (n,).
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
        """Return the contacts of the last step."""
        vehicles = {body: vehicle for vehicle, body in self._bodies.items()}
        ground: set[int] = set()
        pairs: dict[tuple[int, int], tuple[float, float, float]] = {}
        for point in pybullet.getContactPoints(physicsClientId=self._client):
            if point[_CONTACT_DISTANCE] > 0.0 and point[_CONTACT_FORCE] <= 0.0:
                continue  # near, but apart
            bodies = point[_CONTACT_BODY_A], point[_CONTACT_BODY_B]
            pair = sorted(vehicles[body] for body in bodies if body != self._ground)
            if len(pair) == 1:
                ground.add(pair[0])
            else:
                pairs.setdefault((pair[0], pair[1]), point[_CONTACT_POS_ON_A])
        return Touches(frozenset(ground), pairs)

    def close(self) -> None:
        """Disconnect from Bullet; harmless when repeated."""
        if self._client is not None:
            pybullet.disconnect(self._client)
            self._client = None

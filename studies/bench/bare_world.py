"""Minimal PyBullet simulation of rising bodies, as a reference for benchmarks."""

from typing import Self

import pybullet

GRAVITY_M_S2 = 9.8066
MASS_KG = 1.5
SPACING_M = 3.0
_HALF_EXTENTS_M = (0.25, 0.25, 0.05)
_STATE = tuple[tuple[float, ...], tuple[float, ...]]


class BareWorld:
    """Boxes over a plane, each lifted by a force slightly above its weight; single-threaded."""

    def __init__(self, bodies: int, *, step_us: int) -> None:
        self._client: int | None = pybullet.connect(pybullet.DIRECT)
        client = self._client
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=client)
        pybullet.setTimeStep(step_us * 1e-6, physicsClientId=client)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        pybullet.createMultiBody(0.0, plane, physicsClientId=client)
        box = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=_HALF_EXTENTS_M, physicsClientId=client
        )
        self._bodies = [
            pybullet.createMultiBody(
                MASS_KG, box, basePosition=(SPACING_M * i, 0.0, _HALF_EXTENTS_M[2]), physicsClientId=client
            )
            for i in range(bodies)
        ]

    def step(self, lifts_n: list[float]) -> list[tuple[_STATE, _STATE]]:
        """Step with an upward force on each body; returns Bullet's poses and velocities."""
        client = self._client
        for body, lift_n in zip(self._bodies, lifts_n, strict=True):
            pybullet.applyExternalForce(
                body, -1, (0.0, 0.0, lift_n), (0.0, 0.0, 0.0), pybullet.LINK_FRAME, physicsClientId=client
            )
        pybullet.stepSimulation(physicsClientId=client)
        return [
            (
                pybullet.getBasePositionAndOrientation(body, physicsClientId=client),
                pybullet.getBaseVelocity(body, physicsClientId=client),
            )
            for body in self._bodies
        ]

    def close(self) -> None:
        """Disconnect from Bullet; harmless when repeated."""
        if self._client is not None:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

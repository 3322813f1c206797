"""Rotations on scalars are bit-identical to those of the autopilot's kernels."""

import numpy as np
import pytest

from foundation.geometry.rotations import (
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)
from harness.world.physics.rotation import in_frd, in_ned, turned

RNG = np.random.default_rng(3)
QUATERNIONS = [q / np.linalg.norm(q) for q in RNG.standard_normal((50, 4))]


@pytest.mark.parametrize(("mine", "theirs"), [(in_ned, quat_rotate), (in_frd, quat_rotate_inverse)])
def test_vectors_are_rotated_as_in_the_autopilot(mine, theirs):
    for q in QUATERNIONS:
        vector = 10.0 * RNG.standard_normal(3)
        assert list(mine(q, *vector.tolist())) == theirs(q, vector).tolist()


@pytest.mark.parametrize("length_rad", [0.0, 1e-9, 1e-3, 1.0, 10.0])
def test_attitudes_are_rotated_as_in_the_autopilot(length_rad):
    for q in QUATERNIONS:
        rotation_rad = RNG.standard_normal(3)
        rotation_rad *= length_rad / np.linalg.norm(rotation_rad)
        expected = quat_multiply(quat_from_rotation_vector(rotation_rad), q)
        assert list(turned(*rotation_rad.tolist(), q)) == expected.tolist()

"""Quaternion helpers against scipy and against the frames that they are named for."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foundation.geometry import rotations as rot

RANDOM = Rotation.random(50, random_state=np.random.default_rng(1))
QUATS = RANDOM.as_quat(scalar_first=True)
NORTH, EAST, DOWN = np.eye(3)


def same_rotation(q_a, q_b):
    return abs(abs(np.dot(q_a, q_b)) - 1.0) < 1e-14


def test_yaw_turns_the_nose_east_and_pitch_lifts_it_and_roll_lowers_the_right_side():
    quarter = np.pi / 2
    np.testing.assert_allclose(
        rot.quat_rotate(rot.quat_from_euler(0.0, 0.0, quarter), NORTH), EAST, atol=1e-15
    )
    np.testing.assert_allclose(
        rot.quat_rotate(rot.quat_from_euler(0.0, quarter, 0.0), NORTH), -DOWN, atol=1e-15
    )
    np.testing.assert_allclose(
        rot.quat_rotate(rot.quat_from_euler(quarter, 0.0, 0.0), EAST), DOWN, atol=1e-15
    )


def test_rotation_and_product_agree_with_scipy():
    vector = np.array([0.3, -2.0, 5.0])
    for k in range(len(QUATS) - 1):
        q, p = QUATS[k], QUATS[k + 1]
        np.testing.assert_allclose(rot.quat_rotate(q, vector), RANDOM[k].apply(vector), atol=1e-13)
        np.testing.assert_allclose(
            rot.quat_rotate_inverse(q, vector), RANDOM[k].inv().apply(vector), atol=1e-13
        )
        np.testing.assert_allclose(rot.quat_to_dcm(q), RANDOM[k].as_matrix(), atol=1e-14)
        product = (RANDOM[k] * RANDOM[k + 1]).as_quat(scalar_first=True)
        assert same_rotation(rot.quat_multiply(q, p), product)
        assert same_rotation(rot.quat_multiply(rot.quat_conjugate(q), q), [1.0, 0.0, 0.0, 0.0])


def test_euler_angles_are_the_aerospace_sequence_and_round_trip():
    for k, q in enumerate(QUATS):
        euler_rad = rot.quat_to_euler(q)
        np.testing.assert_allclose(euler_rad[::-1], RANDOM[k].as_euler("ZYX"), atol=1e-12)
        assert same_rotation(rot.quat_from_euler(*euler_rad), q)


def test_pitch_of_a_quarter_turn_stays_in_range():
    # rounding may put the sine a bit above one
    for roll_rad in np.linspace(-3.0, 3.0, 50):
        assert rot.quat_to_euler(rot.quat_from_euler(roll_rad, np.pi / 2, 0.4))[1] == pytest.approx(
            np.pi / 2, abs=1e-7
        )


def test_dcm_round_trip_holds_at_every_half_turn():
    axes = [*np.eye(3), *(np.ones((1, 3)) / np.sqrt(3.0)), [0.6, -0.8, 0.0], [0.0, 0.6, -0.8]]
    for axis in axes:
        for angle_rad in (np.pi, np.pi - 1e-9, np.pi - 1e-3):
            q = rot.quat_from_rotation_vector(angle_rad * np.asarray(axis))
            assert same_rotation(rot.quat_from_dcm(rot.quat_to_dcm(q)), q)
    for q in QUATS:
        assert same_rotation(rot.quat_from_dcm(rot.quat_to_dcm(q)), q)
        assert rot.quat_from_dcm(rot.quat_to_dcm(q))[0] >= 0.0


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 0.9e-6, 1.1e-6, 1e-3, 1.0, 3.0, 7.0])
def test_exponential_map_agrees_with_scipy_at_any_length(angle_rad):
    rotation_rad = angle_rad * np.array([0.48, -0.6, 0.64])
    q = rot.quat_from_rotation_vector(rotation_rad)
    np.testing.assert_allclose(rot.quat_to_dcm(q), Rotation.from_rotvec(rotation_rad).as_matrix(), atol=1e-15)
    assert np.dot(q, q) == pytest.approx(1.0, abs=4e-16)

"""Rays meet boxes and the ground where a march along them does."""

import math

import numpy as np
import pytest

from harness.world.obstacles import Box, Obstacles

BOX = Box(from_ned_m=(4.0, -2.0, -6.0), to_ned_m=(5.0, 3.0, -1.0))


def box_of(rng):
    corners = np.sort(rng.uniform(-6.0, 6.0, (2, 3)), axis=0) - (0.0, 0.0, 8.0)
    return Box(from_ned_m=tuple(corners[0]), to_ned_m=tuple(corners[1] + 0.1))


@pytest.mark.parametrize("seed", range(20))
def test_a_ray_ends_at_the_first_point_in_a_box_or_below_the_ground(seed):
    """Steps of 5 mm over 40 m; the march is at most one step later, and never earlier."""
    rng = np.random.default_rng(seed)
    boxes = [box_of(rng) for _ in range(3)]
    from_ned_m, direction_ned = rng.uniform(-9.0, 9.0, 3) - (0.0, 0.0, 10.0), rng.standard_normal(3)
    direction_ned /= np.linalg.norm(direction_ned)
    along_m = np.arange(0.0, 40.0, 0.005)
    points = from_ned_m + along_m[:, None] * direction_ned
    met = points[:, 2] > 0.0
    for box in boxes:
        met |= ((points >= box.from_ned_m) & (points <= box.to_ned_m)).all(axis=1)
    hit = Obstacles(boxes).ray(from_ned_m, direction_ned)
    if met.any():
        # a corner that the march steps over is met earlier, and by less than its steps
        assert hit.distance_m <= along_m[met.argmax()] + 1e-9
        if hit.distance_m > 0.0:
            point = from_ned_m + (hit.distance_m + 1e-6) * direction_ned
            in_box = any(((point >= b.from_ned_m) & (point <= b.to_ned_m)).all() for b in boxes)
            assert in_box or point[2] > 0.0
    else:
        assert hit.distance_m > 39.9


def test_incidence_is_that_on_the_side_which_is_met():
    obstacles = Obstacles([BOX])
    direction = np.array((math.cos(0.3), math.sin(0.3), 0.0))
    hit = obstacles.ray(np.array((0.0, -1.0, -3.0)), direction)
    assert hit.distance_m == pytest.approx(4.0 / math.cos(0.3))
    assert hit.incidence_cos == pytest.approx(math.cos(0.3))
    ground = obstacles.ray(np.array((0.0, 0.0, -3.0)), np.array((0.6, 0.0, 0.8)))
    assert (ground.distance_m, ground.incidence_cos) == (pytest.approx(3.0 / 0.8), pytest.approx(0.8))


@pytest.mark.parametrize(
    ("from_ned_m", "direction_ned", "distance_m"),
    [
        ((4.5, 0.0, -3.0), (0.0, 0.0, -1.0), 0.0),  # within the box
        ((4.0, 0.0, -9.0), (0.0, 0.0, 1.0), 3.0),  # in the plane of a side
        ((0.0, 3.01, -3.0), (1.0, 0.0, 0.0), math.inf),  # beside it
        ((9.0, 0.0, -3.0), (1.0, 0.0, 0.0), math.inf),  # behind the ray
        ((0.0, 0.0, -2.0), (0.0, 0.0, -1.0), math.inf),  # into the sky
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0),  # on the ground
        ((0.0, 0.0, 0.5), (0.0, 0.0, -1.0), 0.0),  # below it
    ],
)
def test_special_rays(from_ned_m, direction_ned, distance_m):
    hit = Obstacles([BOX]).ray(np.array(from_ned_m), np.array(direction_ned))
    assert hit.distance_m == pytest.approx(distance_m)


@pytest.mark.parametrize("seed", range(20))
def test_a_box_obstructs_a_line_in_both_directions(seed):
    rng = np.random.default_rng(seed)
    obstacles = Obstacles([box_of(rng)])
    first, second = rng.uniform(-8.0, 8.0, (2, 3)) - (0.0, 0.0, 8.0)
    assert obstacles.is_between(first, second) == obstacles.is_between(second, first)
    assert not Obstacles().is_between(first, second)


def test_a_line_that_ends_before_the_box_is_clear():
    obstacles = Obstacles([BOX])
    assert not obstacles.is_between(np.array((0.0, 0.0, -3.0)), np.array((3.9, 0.0, -3.0)))
    assert obstacles.is_between(np.array((0.0, 0.0, -3.0)), np.array((4.1, 0.0, -3.0)))
    assert not obstacles.is_between(np.zeros(3), np.zeros(3))


def test_corners_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="to_ned_m: expected coordinates greater"):
        Box(from_ned_m=(1.0, 0.0, 0.0), to_ned_m=(0.0, 1.0, 1.0))

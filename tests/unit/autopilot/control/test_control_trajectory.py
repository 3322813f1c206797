"""Jerk-limited motion along a line: where it stops."""

import math

import pytest

from autopilot.control.trajectory import stopping_distance


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_stopping_distance(sign):
    # 3 m/s at jerk 4, limit 3: 0.75 s to full braking, 0.25 s of it, 0.75 s back; symmetric, so v T / 2
    assert stopping_distance(sign * 3.0, 0.0, -3.0, 3.0, 4.0) == pytest.approx(sign * 3.0 * 1.75 / 2.0)
    # 1 m/s never reaches the limit: 2 sqrt(v / J)
    assert stopping_distance(sign * 1.0, 0.0, -3.0, 3.0, 4.0) == pytest.approx(sign * 2.0 * 0.5 / 2.0)
    # at rest with an acceleration of 2 m/s^2: 0.5 s to zero, after 1/6 m and 0.5 m/s; then 2 sqrt(v / J) to
    # rest
    expected = 1.0 / 6.0 + 0.5 * 2.0 * math.sqrt(0.5 / 4.0) / 2.0
    assert stopping_distance(0.0, sign * 2.0, -3.0, 3.0, 4.0) == pytest.approx(sign * expected)

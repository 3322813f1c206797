"""Jerk-limited motion along a line to a position.

At every step it uses the greatest jerk after which it can still stop at the target: it accelerates, cruises
and brakes in minimum time, from any state and to a target that may change at any time.
"""

import math

from numba import njit

from foundation.types import Array

_BISECTIONS = 30
"""Resolves the jerk to 2e-9 of its limit"""


@njit(cache=True)
def stopping_distance(vel: float, acc: float, acc_min: float, acc_max: float, jerk: float) -> float:
    """Return the signed distance to rest (velocity and acceleration 0) in minimum time.

    acc_min < 0 < acc_max. The acceleration changes at full jerk to a peak against the motion, stays there if
    the peak is the limit, and returns to 0 at full jerk.
    """
    sign, brake = 1.0, -acc_min
    if vel + acc * abs(acc) / (2.0 * jerk) < 0.0:
        sign, brake = -1.0, acc_max
        vel, acc = -vel, -acc
    peak = math.sqrt(max(jerk * vel + 0.5 * acc * acc, 0.0))  # without the limit
    hold = 0.0
    if peak > brake:
        peak = max(brake, -acc)
        hold = max((vel + acc * acc / (2.0 * jerk) - peak * peak / jerk) / peak, 0.0)
    distance = 0.0
    for phase in range(3):
        if phase == 0:
            t, j = (acc + peak) / jerk, -jerk
        elif phase == 1:
            t, j = hold, 0.0
        else:
            t, j = peak / jerk, jerk
        distance += t * (vel + t * (acc / 2.0 + t * j / 6.0))
        vel += t * (acc + t * j / 2.0)
        acc += t * j
    return sign * distance


@njit(cache=True, inline="always")
def _speed_after(vel: float, acc: float, jerk: float) -> float:
    """Return the speed after the acceleration has returned to 0 at full jerk."""
    return vel + acc * abs(acc) / (2.0 * jerk)


@njit(cache=True)
def line_jerk(pos: float, vel: float, acc: float, target: float, limits: Array, dt_s: float) -> float:
    """Return the jerk for the next ``dt_s``.

    ``limits``: vel_min, vel_max, acc_min, acc_max, jerk; minima are negative. Stopping position and final
    speed both increase with the present jerk, so bisection finds one bound for each condition. Priority:
    stopping at the target, the speed limit, the acceleration limit.
    """
    vel_min, vel_max, acc_min, acc_max, jerk = limits[0], limits[1], limits[2], limits[3], limits[4]
    low, high = -jerk, jerk
    for _ in range(_BISECTIONS):
        j = 0.5 * (low + high)
        a = acc + j * dt_s
        v = vel + (acc + 0.5 * j * dt_s) * dt_s
        end = (
            pos
            + (vel + (acc / 2.0 + j * dt_s / 6.0) * dt_s) * dt_s
            + stopping_distance(v, a, acc_min, acc_max, jerk)
        )
        if end > target:
            high = j
        else:
            low = j
    demanded = 0.5 * (low + high)
    for bound in (vel_min, vel_max):
        low, high = -jerk, jerk
        for _ in range(_BISECTIONS):
            j = 0.5 * (low + high)
            if _speed_after(vel + (acc + 0.5 * j * dt_s) * dt_s, acc + j * dt_s, jerk) > bound:
                high = j
            else:
                low = j
        demanded = max(demanded, low) if bound == vel_min else min(demanded, high)
    demanded = min(max(demanded, (acc_min - acc) / dt_s), (acc_max - acc) / dt_s)
    return float(min(max(demanded, -jerk), jerk))

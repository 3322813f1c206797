"""The consensus law, without time or I/O. Positions are north and east, metres.

Each UAV i has a fixed offset d_i from the meeting point, and its state is z_i = x_i - d_i: the meeting point
as far as it depends on this UAV alone. It flies at the velocity

    v_i = sat(g (mean of z_j - z_i)),   mean over itself and the n_i neighbours that it receives,

where sat shortens a vector to the greatest speed. All have met when all z_i are equal.

**Limit of the gain.** Between two beacons, T seconds, each UAV flies on. Below the greatest speed the law is
then z[k+1] = (I - g T (I - W)) z[k], with the row-stochastic matrix W of the means: W_ij = 1 / (n_i + 1). The
matrix of the step is row-stochastic too, with a positive diagonal, if g T n_i / (n_i + 1) < 1, which g T < 1
ensures for any number of neighbours. Products of such matrices converge to equal z_i if the union of the
graphs over some bounded time has a spanning tree again and again: W. Ren and R. W. Beard, "Consensus seeking
in multiagent systems under dynamically changing interaction topologies", IEEE Transactions on Automatic
Control 50 (2005). So lost beacons delay the meeting and do not prevent it. For equal weights on a fixed
graph, a step of less than 1 / (greatest degree) is the condition of R. Olfati-Saber, J. A. Fax and R. M.
Murray, "Consensus and cooperation in networked multi-agent systems", Proceedings of the IEEE 95 (2007),
theorem 2.

**Time of convergence.** Let all N UAVs receive all others, and D be the greatest distance of two z. For the
two UAVs at this distance, all others lie in the lens of two circles of radius D around them, so the demanded
velocity of each has no component away from the other. Without sat the two components add up to g D. Since
|mean - z_i| is at most D (N - 1) / N < D, sat multiplies them by at least min(1, speed / (g D)). Therefore
dD/dt <= -min(g D, speed), which `meeting_time_s` integrates.

**Distances.** Offsets are parallel to the places of the start. As long as no velocity is shortened, the
vector from one UAV to another keeps its direction, and shrinks to that of the offsets.
"""

import math
from collections.abc import Sequence

Horizontal = tuple[float, float]


def offsets_m(places_m: Sequence[Horizontal], spacing_m: float) -> list[Horizontal]:
    """Return an offset (north, east) from the meeting point for each place: the scaled places, centred.

    The least distance of two offsets is ``spacing_m``, or that of the places if they are nearer. Raises
    ValueError if two places are equal.
    """
    pairs = [math.dist(a, b) for i, a in enumerate(places_m) for b in places_m[:i]]
    nearest_m = min(pairs, default=spacing_m)
    if nearest_m == 0.0:
        raise ValueError("formation: two places are above each other; a rendezvous needs places side by side")
    scale = min(1.0, spacing_m / nearest_m)
    north_m, east_m = mean(places_m)
    return [(scale * (n - north_m), scale * (e - east_m)) for n, e in places_m]


def velocity_m_s(
    own_m: Horizontal, others_m: Sequence[Horizontal], gain_1_s: float, speed_m_s: float
) -> Horizontal:
    """Return the velocity (north, east) of the law; ``own_m`` is z_i, ``others_m`` are the received z_j."""
    north_m, east_m = mean([own_m, *others_m])
    north_m_s, east_m_s = gain_1_s * (north_m - own_m[0]), gain_1_s * (east_m - own_m[1])
    share = min(1.0, speed_m_s / max(math.hypot(north_m_s, east_m_s), 1e-9))
    return share * north_m_s, share * east_m_s


def spread_m(states_m: Sequence[Horizontal]) -> float:
    """Return the greatest distance of two states; 0 for fewer than two."""
    return max((math.dist(a, b) for i, a in enumerate(states_m) for b in states_m[:i]), default=0.0)


def meeting_time_s(begin_m: float, end_m: float, gain_1_s: float, speed_m_s: float) -> float:
    """Return the time in which the law reduces the spread from ``begin_m`` to ``end_m``, at most."""
    linear_m = speed_m_s / gain_1_s
    fast_s = max(0.0, begin_m - max(linear_m, end_m)) / speed_m_s
    slow_s = max(0.0, math.log(min(begin_m, linear_m) / end_m)) / gain_1_s
    return fast_s + slow_s


def mean(points_m: Sequence[Horizontal]) -> Horizontal:
    """Return the mean of at least one point."""
    count = len(points_m)
    return sum(n for n, _ in points_m) / count, sum(e for _, e in points_m) / count

"""Budget of a link's received MAVLink frames: datagrams beyond it are dropped unread. No I/O.

Token buckets count frames, one for each partner and one for the whole link. They fill with time: simulated
time, so that a flood costs a flight the same whatever its speed, or wall time where that passes faster, so
that partners are answered while simulated time rests.
"""

from collections.abc import Hashable

PARTNER_FRAMES_S = 300
"""Frames of one partner per second: six times a stream of setpoints at 50 Hz. Transfers of parameters, plans,
files and logs are requests and replies, at most one per poll of the link, which are 50 a second."""
LINK_FRAMES_S = 600
"""Frames of all partners of a link per second."""
REJECTED_FRAME_COST = 0.125
"""Cost of an apparent frame that is no message, as a part of that of a message: it is only parsed."""
BURST_S = 1.0
"""Time for which an unused budget is kept."""
MOST_PARTNERS = 64
"""Partners with a bucket of their own; one more replaces the one that was silent longest."""
_US_PER_S = 1_000_000


class _Bucket:
    """Frames that may be read now, at most ``BURST_S`` of its rate; negative: a debt."""

    def __init__(self, frames_s: int, now_us: int) -> None:
        self._frames_s = frames_s
        self._most = frames_s * BURST_S
        self._left = self._most
        self._now_us = now_us

    def has_left(self, now_us: int) -> bool:
        """Whether the next datagram may be read."""
        earned = (now_us - self._now_us) * self._frames_s / _US_PER_S
        self._left, self._now_us = min(self._left + earned, self._most), now_us
        return self._left > 0.0

    def spend(self, cost: float) -> None:
        """Charge a datagram."""
        self._left -= cost


class InputBudget:
    """The budget of one link; partners are named by their addresses."""

    def __init__(self, partner_frames_s: int = PARTNER_FRAMES_S, link_frames_s: int = LINK_FRAMES_S) -> None:
        self._partner_frames_s = partner_frames_s
        self._now_us = 0
        """Time of the buckets, the sum of the intervals given to `advance`."""
        self._simulated_us = 0
        self._wall_us = 0
        self._link = _Bucket(link_frames_s, 0)
        self._partners: dict[Hashable, _Bucket] = {}
        """The most recent sender is last."""

    def advance(self, simulated_us: int, wall_us: int) -> None:
        """Let time pass until these instants of simulated and of wall time."""
        self._now_us += max(simulated_us - self._simulated_us, wall_us - self._wall_us, 0)
        self._simulated_us, self._wall_us = simulated_us, wall_us

    def admits(self, partner: Hashable) -> bool:
        """Whether a partner's next datagram may be read; `spend` then charges its frames."""
        bucket = self._partners.pop(partner, None)
        if bucket is None:
            bucket = _Bucket(self._partner_frames_s, self._now_us)
            if len(self._partners) >= MOST_PARTNERS:
                del self._partners[next(iter(self._partners))]
        self._partners[partner] = bucket
        return bucket.has_left(self._now_us) and self._link.has_left(self._now_us)

    def spend(self, partner: Hashable, messages: int, rejected_frames: int = 0) -> None:
        """Charge a datagram that was admitted: its messages and its other apparent frames, at least one."""
        cost = max(messages + rejected_frames * REJECTED_FRAME_COST, 1.0)
        self._partners[partner].spend(cost)
        self._link.spend(cost)

"""Ranging policies: their interface, and the simplest one, which measures all pairs once per period.

With `RangingSchedule` every UAV ranges to every other one, evenly spread over the period. Each has its own
random phase, and starts its round with the station after itself, as UAVs that began their rounds together
would contend for the channel. `scheduled_ranging` needs less airtime.
"""

from collections.abc import Callable, Collection
from typing import Protocol

import numpy as np

from autopilot.parameters.config import SESSION_S

MAX_OUTSTANDING = 2
"""A second session may be requested while one runs, so a slow peer does not delay the round. On a full
channel the limit slows the policy down instead of filling its queue."""
GIVE_UP_US = 2_000_000
"""A request without a result is dropped after this time, which exceeds any driver's time-out."""

Reachable = Callable[[int], bool]
"""Whether a beacon of a peer has been received recently."""
VarianceOf = Callable[[int], float | None]
"""Variance, m^2, of the distance to a peer as estimated without a new measurement; None: not estimated."""


class RangingPolicy(Protocol):
    """Interface of a ranging policy; times are us on the clock that the formation shares."""

    next_us: float
    """`due` returns nothing before this time."""
    silence_us: int
    """Longest time between two distances of a UAV that ranges, losses included."""
    gather_s: float
    """Time from the start within which every unknown distance has been requested twice."""

    def due(
        self, now_us: int, until_us: int, reachable: Reachable, variance_m2: VarianceOf | None = None
    ) -> list[tuple[int, int]]:
        """List the requests to hand over in [now, until): (at_us, peer), of peers that are ``reachable``."""

    def on_result(
        self, peer: int, *, ended_us: int = 0, variance_m2: float | None = None, retry_after_us: int = 0
    ) -> None:
        """Record that the session with a peer ended; ``variance_m2`` of the distance is None if it failed.

        A responder that refused may have stated a time ``retry_after_us`` before the next request.
        """

    def on_survey(self, ended_ns: int, busy_ns: int) -> None:
        """Record the total time for which the medium had been busy at ``ended_ns``."""


class Outstanding(dict[int, int]):
    """Times of the requests without a result yet, by peer."""

    def forget_old(self, now_us: int) -> None:
        """Drop the requests without a result for `GIVE_UP_US`."""
        for peer, since_us in list(self.items()):
            if now_us - since_us > GIVE_UP_US:
                del self[peer]

    @property
    def full(self) -> bool:
        """Whether the limit of outstanding requests is reached."""
        return len(self) >= MAX_OUTSTANDING


class RangingSchedule:
    """All-pairs round robin of one station; the first round starts with the first call of `due`.

    ``peers`` are the stations to range to; None: all others.
    """

    def __init__(
        self, *, station: int, stations: int, period_us: int, rng: np.random.Generator,
        peers: Collection[int] | None = None,
    ) -> None:  # fmt: skip
        others = [(station + k) % stations for k in range(1, stations)]
        self._peers = [peer for peer in others if peers is None or peer in peers]
        self._slot_us = period_us / max(len(self._peers), 1)
        self._phase = float(rng.uniform())
        self._begun = False
        self.next_us = 0.0 if self._peers else float("inf")
        self.silence_us = 2 * period_us + 1_000_000
        self.gather_s = 2e-6 * period_us + SESSION_S
        self._next = 0
        self._outstanding = Outstanding()

    def due(
        self, now_us: int, until_us: int, reachable: Reachable,
        variance_m2: VarianceOf | None = None,  # noqa: ARG002  # all pairs are measured
    ) -> list[tuple[int, int]]:  # fmt: skip
        """See `RangingPolicy`."""
        if not self._peers:
            return []
        if not self._begun:
            self._begun = True
            self.next_us = now_us + self._phase * self._slot_us
        if now_us - self.next_us > GIVE_UP_US:  # the clock has jumped: skip the slots in between
            self.next_us += (now_us - self.next_us) // self._slot_us * self._slot_us
        self._outstanding.forget_old(now_us)
        requests = []
        while self.next_us < until_us:
            peer = self._peers[self._next]
            if reachable(peer) and peer not in self._outstanding:
                if self._outstanding.full:
                    # The round is delayed instead of skipping peers; a burst does not follow a full channel.
                    self.next_us = max(self.next_us, float(until_us))
                    break
                at_us = max(int(self.next_us), now_us)
                self._outstanding[peer] = at_us
                requests.append((at_us, peer))
            self._next = (self._next + 1) % len(self._peers)
            self.next_us += self._slot_us
        return requests

    def on_result(
        self, peer: int, *, ended_us: int = 0,  # noqa: ARG002
        variance_m2: float | None = None, retry_after_us: int = 0,  # noqa: ARG002
    ) -> None:  # fmt: skip
        """Record that the session with this peer has ended, with any status."""
        self._outstanding.pop(peer, None)

    def on_survey(self, ended_ns: int, busy_ns: int) -> None:
        """Ignore the survey: the period is fixed."""

"""When to range to whom: what every policy offers, and the simplest, all pairs once per period.

`RangingSchedule` has every UAV range to every other, evenly spread, out of step with the other UAVs: eight
UAVs that began their rounds together would contend for the air in the same milliseconds of every second, so
each spreads its requests over the whole period from a phase of its own, and starts its round with the station
after itself. `scheduled_ranging` spends less time on the air.
"""

from collections.abc import Callable, Collection
from typing import Protocol

import numpy as np

from autopilot.parameters.config import SESSION_S

MAX_OUTSTANDING = 2
"""A second session may be asked for while one runs: a slow peer then does not hold up the round, and a full
channel slows the policy down instead of filling its queue."""
GIVE_UP_US = 2_000_000
"""A request without any result is forgotten after this, longer than any driver's time-out."""

Reachable = Callable[[int], bool]
"""Whether a peer has been heard of lately."""
VarianceOf = Callable[[int], float | None]
"""Variance in m2 with which the distance to a peer is known without measuring it now; None: it is not."""


class RangingPolicy(Protocol):
    """Times are us on the clock that the formation shares.

    Attributes:
        next_us: before this, `due` has nothing to say.
        silence_us: a UAV that ranges at all has had a distance within this, lost ones included.
        gather_s: within this, from the first on, all distances of which nothing is known yet have been asked
            for twice.

    """

    next_us: float
    silence_us: int
    gather_s: float

    def due(
        self, now_us: int, until_us: int, reachable: Reachable, variance_m2: VarianceOf | None = None
    ) -> list[tuple[int, int]]:
        """List the requests to hand over in [now, until): (at_us, peer), of peers that are ``reachable``."""
        ...

    def on_result(
        self, peer: int, *, ended_us: int = 0, variance_m2: float | None = None, retry_after_us: int = 0
    ) -> None:
        """Note that the session with a peer ended at ``ended_us``.

        ``variance_m2`` is that of the distance, None if the session gave none; a responder that refused may
        have said for how long it does not want to be asked again.
        """
        ...

    def on_survey(self, ended_ns: int, busy_ns: int) -> None:
        """Note for how long the medium had been busy in all, at ``ended_ns``."""
        ...


class Outstanding:
    """Requests without a result yet."""

    def __init__(self) -> None:
        self._since_us: dict[int, int] = {}

    def forget_old(self, now_us: int) -> None:
        """Give up those that have had no result for too long."""
        for peer, since_us in list(self._since_us.items()):
            if now_us - since_us > GIVE_UP_US:
                del self._since_us[peer]

    def add(self, peer: int, at_us: int) -> None:
        """Note a request."""
        self._since_us[peer] = at_us

    def discard(self, peer: int) -> None:
        """Note a result."""
        self._since_us.pop(peer, None)

    def __contains__(self, peer: int) -> bool:
        return peer in self._since_us

    @property
    def full(self) -> bool:
        """Whether no more may be asked for."""
        return len(self._since_us) >= MAX_OUTSTANDING


class RangingSchedule:
    """All-pairs round robin of one station; the first round starts with the first `due`.

    Takes no account of what the distances are worth or of how full the channel is. See `RangingPolicy`.
    ``peers`` are those to range to; None: all others.
    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        period_us: int,
        rng: np.random.Generator,
        peers: Collection[int] | None = None,
    ) -> None:
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
        self,
        now_us: int,
        until_us: int,
        reachable: Reachable,
        variance_m2: VarianceOf | None = None,  # noqa: ARG002  # all are measured
    ) -> list[tuple[int, int]]:
        """List the requests to hand over in [now, until): (at_us, peer), of peers that are ``reachable``."""
        if not self._peers:
            return []
        if not self._begun:
            self._begun = True
            self.next_us = now_us + self._phase * self._slot_us
        if now_us - self.next_us > GIVE_UP_US:  # the clock has leapt: those would have been answered by now
            self.next_us += (now_us - self.next_us) // self._slot_us * self._slot_us
        self._outstanding.forget_old(now_us)
        requests = []
        while self.next_us < until_us:
            peer = self._peers[self._next]
            if reachable(peer) and peer not in self._outstanding:
                if self._outstanding.full:
                    # The round slips rather than skips; slots lost to a full channel are not made up for in
                    # a burst.
                    self.next_us = max(self.next_us, float(until_us))
                    break
                at_us = max(int(self.next_us), now_us)
                self._outstanding.add(peer, at_us)
                requests.append((at_us, peer))
            self._next = (self._next + 1) % len(self._peers)
            self.next_us += self._slot_us
        return requests

    def on_result(
        self,
        peer: int,
        *,
        ended_us: int = 0,  # noqa: ARG002
        variance_m2: float | None = None,  # noqa: ARG002
        retry_after_us: int = 0,  # noqa: ARG002
    ) -> None:
        """Note that the session with this peer has ended, whatever its status."""
        self._outstanding.discard(peer)

    def on_survey(self, ended_ns: int, busy_ns: int) -> None:
        """Take no notice: the period is what it is."""

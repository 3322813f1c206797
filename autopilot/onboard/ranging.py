"""When to range to whom: every other UAV once per period, evenly spread, out of step with the other UAVs.

Eight UAVs that began their rounds together would contend for the air in the same milliseconds of every
second, so each spreads its requests over the whole period from a phase of its own, and starts its round with
the station after itself.
"""

import numpy as np

MAX_OUTSTANDING = 2
"""A second session may be asked for while one runs: a slow peer then does not hold up the round, and a full
channel slows the policy down instead of filling its queue."""
GIVE_UP_US = 2_000_000
"""A request without any result is forgotten after this, longer than any driver's time-out."""


class RangingSchedule:
    """All-pairs round robin of one station. Times are us; the first round starts with the first `due`.

    Attributes:
        next_us: before this, `due` has nothing to say.

    """

    def __init__(self, *, station: int, stations: int, period_us: int, rng: np.random.Generator) -> None:
        self._peers = [(station + k) % stations for k in range(1, stations)]
        self._slot_us = period_us / max(len(self._peers), 1)
        self._phase = float(rng.uniform())
        self._begun = False
        self.next_us = 0.0
        self._next = 0
        self._outstanding: dict[int, int] = {}

    def due(self, now_us: int, until_us: int, reachable: set[int]) -> list[tuple[int, int]]:
        """List the requests to hand over in [now, until): (at_us, peer), of peers that are ``reachable``."""
        if not self._peers:
            return []
        if not self._begun:
            self._begun = True
            self.next_us = now_us + self._phase * self._slot_us
        for peer, since_us in list(self._outstanding.items()):
            if now_us - since_us > GIVE_UP_US:
                del self._outstanding[peer]
        requests = []
        while self.next_us < until_us:
            peer = self._peers[self._next]
            if peer in reachable and peer not in self._outstanding:
                if len(self._outstanding) >= MAX_OUTSTANDING:
                    # The round slips rather than skips; slots lost to a full channel are not made up for in
                    # a burst.
                    self.next_us = max(self.next_us, float(until_us))
                    break
                at_us = max(int(self.next_us), now_us)
                self._outstanding[peer] = at_us
                requests.append((at_us, peer))
            self._next = (self._next + 1) % len(self._peers)
            self.next_us += self._slot_us
        return requests

    def on_result(self, peer: int) -> None:
        """Note that the session with this peer has ended, whatever its status."""
        self._outstanding.pop(peer, None)

"""The token-ring protocol of one station, without I/O: datagrams, outcomes and time in, datagrams out.

The token travels from station to station in the order of their numbers. A station holds it for a fixed time
and passes it to its successor by unicast, which the MAC layer acknowledges and repeats.

- Outcome `acknowledged`: the successor has the token.
- Any other outcome: the successor may have it nevertheless, because only acknowledgements may have been lost.
  The station passes the token on to the one after it, and tries its successor again in its next turn.
- A token has a generation and a version, which counts the stations that it has passed or left out. So at
  station i it is i modulo N, and equal for all copies in one round. A station ignores a token that is not
  newer than the newest that it has seen: a copy ends where another one has been before it.
- A station that has not seen a token for `Timing.timeout_us` makes a new one, of the next generation.

**Time-outs.** Between two turns of a station each of the N stations holds the token for at most ``hold`` and
passes it within ``pass``, the time of a unicast with all retries. A station that does not answer costs one
``pass`` more. So a round lasts at most N (hold + 2 pass), after which the token is lost. Station i waits
longer by i (hold + pass): stations that lost sight of the token together receive that of the lowest one
before their own time-out. Two that make one nevertheless make copies, of which one ends as above.
"""

import struct
from typing import NamedTuple

from msgspec import Struct

_FORMAT = struct.Struct("<2sBIQ")
_MAGIC, _VERSION = b"TR", 1
_MOST_GENERATIONS, _MOST_VERSIONS = 2**31, 2**63
"""Numbers from these on, half of what their fields hold, are not reached by any ring."""


class Token(NamedTuple):
    """The token; newer ones compare greater."""

    generation: int
    version: int
    """Number of stations that it has passed or left out, from station 0 on."""

    def encode(self) -> bytes:
        """Return its 15 bytes."""
        return _FORMAT.pack(_MAGIC, _VERSION, *self)


def decode(payload: bytes) -> Token | None:
    """Return the token of a datagram; None for bytes that are none."""
    if len(payload) != _FORMAT.size:
        return None
    magic, version, *fields = _FORMAT.unpack(payload)
    token = Token(*fields)
    fits = token.generation < _MOST_GENERATIONS and token.version < _MOST_VERSIONS
    return token if fits and (magic, version) == (_MAGIC, _VERSION) else None


class Timing(Struct, frozen=True, kw_only=True):
    """Times of the ring, microseconds."""

    stations: int
    hold_us: int
    """Time for which a station keeps the token."""
    pass_us: int
    """Longest time from a unicast to its outcome, and to the receiver's next iteration."""

    def timeout_us(self, station: int) -> int:
        """Return the time without a token after which a station makes a new one; see above."""
        round_us = self.stations * (self.hold_us + 2 * self.pass_us)
        return round_us + station * (self.hold_us + self.pass_us)


class Ring:
    """The protocol at one station. Methods return the destination and token of a unicast, or None."""

    def __init__(self, station: int, timing: Timing) -> None:
        self.station, self._timing = station, timing
        self.newest: Token | None = None
        """The newest token that this station has seen."""
        self.holds = False
        """Whether it has the token and may use what the token grants."""
        self.turns = self.regenerated = self.ignored = 0
        """Times it has held a token; tokens it has made; old copies it has ignored."""
        self._since_us = 0
        """When it received the token, or has last seen the ring alive."""
        self._passed_to: int | None = None
        """Station whose outcome is awaited."""

    @property
    def rounds(self) -> int:
        """Rounds that the newest token has completed."""
        return 0 if self.newest is None else self.newest.version // self._timing.stations

    def on_token(self, token: Token, now_us: int) -> None:
        """Process a token that was received."""
        if self.newest is not None and token <= self.newest:
            self.ignored += 1
            return
        self._passed_to = None  # a newer token exists: what was passed on is old
        self._take(token, now_us)

    def on_outcome(self, destination: int, now_us: int, *, acknowledged: bool) -> tuple[int, Token] | None:
        """Process the outcome of the unicast; returns the next one after a failure."""
        if destination != self._passed_to:
            return None
        self._passed_to = None
        self._since_us = now_us
        return None if acknowledged else self._pass_on(after=destination)

    def on_timer(self, now_us: int) -> tuple[int, Token] | None:
        """Pass the token on after the hold time; make a new one after the time-out."""
        if self.holds:
            if now_us - self._since_us >= self._timing.hold_us:
                self.holds, self._since_us = False, now_us
                return self._pass_on(after=self.station)
        elif self._passed_to is None and now_us - self._since_us >= self._timing.timeout_us(self.station):
            self.regenerated += 1
            generation, version = self.newest or Token(0, -1)
            version += 1 + (self.station - version - 1) % self._timing.stations
            self._take(Token(generation + 1, version), now_us)
        return None

    def _take(self, token: Token, now_us: int) -> None:
        self.newest, self.holds, self._since_us = token, True, now_us
        self.turns += 1

    def _pass_on(self, after: int) -> tuple[int, Token] | None:
        """Return the unicast to the station after another one; keep the token if that is this station."""
        if self.newest is None:
            return None
        count = self._timing.stations
        destination = (after + 1) % count
        # after a failure the newest version is that of the station that failed
        version = self.newest.version + (destination - self.newest.version) % count
        token = Token(self.newest.generation, version)
        if destination == self.station:  # no other station answers
            self._take(token, self._since_us)
            return None
        self.newest, self._passed_to = token, destination
        return destination, token

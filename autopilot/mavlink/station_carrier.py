"""What carriers over a vehicle's radio and over its serial modem share. No I/O.

Both send items to stations by the emulator. Nothing reports that the program of a station has ended, and
what other stations send does not get as far as the link.
"""

from collections import deque
from collections.abc import Sequence

from netsim.wire.messages import TxItem

FIRST_SEQUENCE = 2**62
"""Sequence number of a link's first item; those of the applications count from 0."""
_MOST_WAITING = 1_024
"""Received pieces that wait for the link; the oldest are dropped."""


class StationCarrier:
    """Part of a carrier (`autopilot.mavlink.links.Carrier`) to the stations with these numbers."""

    def __init__(self, stations: Sequence[int]) -> None:
        self.defaults = tuple(stations)
        self.now_us = 0
        """Simulated time of what is sent next."""
        self.foreign = 0
        """Number of datagrams to the link's port from other stations, which are dropped."""
        self._received: deque[tuple[bytes, int]] = deque(maxlen=_MOST_WAITING)
        """Contents and senders"""
        self._items: list[TxItem] = []
        self._sequence = FIRST_SEQUENCE

    @property
    def has_received(self) -> bool:
        """Whether there is something for `receive`."""
        return bool(self._received)

    def take_out(self) -> tuple[TxItem, ...]:
        """Return the items to be sent, and forget them."""
        items, self._items = tuple(self._items), []
        return items

    def receive(self) -> tuple[bytes, int] | None:
        """Return what has arrived next, and the number of the station that sent it."""
        return self._received.popleft() if self._received else None

    @staticmethod
    def wall_s() -> float:
        """Return 0: budgets follow simulated time, so that a flight depends on nothing else."""
        return 0.0

    @staticmethod
    def take_unreachable(*, look: bool = False) -> Sequence[int]:  # noqa: ARG004  as any carrier
        """Return none."""
        return ()

    @staticmethod
    def trusts(sender: int, wall_s: float) -> bool:  # noqa: ARG004  as any carrier
        """Return True."""
        return True

    @staticmethod
    def may_send(address: int, wall_s: float, *, has_sent: bool) -> bool:  # noqa: ARG004  as any carrier
        """Return True."""
        return True

    def _queue(self, item: TxItem) -> None:
        self._items.append(item)
        self._sequence += 1

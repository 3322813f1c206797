"""The partners of a link: its default destinations, and the addresses that have sent to it. No I/O."""

from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

MAX_PARTNERS = 8
"""A new partner replaces the one that was silent longest, except default partners."""
BROADCAST = -1
"""As a partner's number: all partners."""

A = TypeVar("A")
S = TypeVar("S")
A_contra = TypeVar("A_contra", contravariant=True)


class MaySend(Protocol[A_contra]):
    """Whether an address may be sent to; ``has_sent``: it has sent something."""

    def __call__(self, address: A_contra, /, *, has_sent: bool) -> bool:
        """Return the answer."""


class Peer(Generic[S]):
    """One partner: its number, and the ``state`` that the link keeps for it."""

    def __init__(self, number: int, state: S) -> None:
        self.number = number
        self.state = state


class Partners(Generic[A, S]):
    """Partners by address of type A; ``make_state`` returns the state of a new one.

    A default partner is sent to whether it has sent anything or not. It is numbered while it is reachable
    and has sent something; its state is never made again.
    """

    def __init__(self, defaults: Sequence[A], make_state: Callable[[], S]) -> None:
        self._make_state = make_state
        self._defaults = {address: Peer(BROADCAST, make_state()) for address in defaults}
        self._listening: set[A] = set()
        """Default partners that were sent to and not found unreachable since."""
        self._senders: dict[A, Peer[S]] = {}
        """Those that have sent something; the most recent one is last."""
        self._next_number = 0

    @property
    def any_listens(self) -> bool:
        """Whether there is a partner that is not known to be unreachable."""
        return bool(self._listening or self._senders)

    def add(self, address: A) -> int:
        """Note that an address has sent something; return its number."""
        peer = self._senders.pop(address, None)
        if peer is None:
            peer = self._defaults.get(address) or Peer(BROADCAST, self._make_state())
            if peer.number == BROADCAST:
                peer.number = self._next_number
                self._next_number += 1
        self._senders[address] = peer
        if len(self._senders) > max(MAX_PARTNERS, len(self._defaults)):
            del self._senders[next(other for other in self._senders if other not in self._defaults)]
        return peer.number

    def remove(self, address: A) -> None:
        """Forget an unreachable partner; a default one is sent to again."""
        self._senders.pop(address, None)
        self._listening.discard(address)
        if address in self._defaults:
            self._defaults[address].number = BROADCAST  # the next partner there gets a new number

    def note_sent(self, address: A) -> None:
        """Note that something is sent to a partner: a default one counts as listening until it is removed."""
        if address in self._defaults:
            self._listening.add(address)

    def recipients(self, may_send: MaySend[A]) -> dict[A, Peer[S]]:
        """Return the partners that may be sent to."""
        chosen = {
            address: peer for address, peer in self._senders.items() if may_send(address, has_sent=True)
        }
        for address, peer in self._defaults.items():
            if address in self._senders:
                continue
            if may_send(address, has_sent=False):
                chosen[address] = peer
            else:
                self._listening.discard(address)
        return chosen

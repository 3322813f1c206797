"""A vehicle's link: MAVLink to and from ground stations and companions, over what carries its datagrams.

`MavlinkLink` has the partners, parses, signs and packs; a `Carrier` transports datagrams: a UDP socket
(`udp_link.UdpLink`) or the vehicle's radio (`radio_carrier.RadioCarrier`). Signatures have the wall clock.
"""

import time
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser, Sequences, signed
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.partners import BROADCAST, Partners, Peer
from autopilot.mavlink.signing import EPOCH_UNIX_S, TICKS_PER_S, Signer
from autopilot.mavlink.udp_socket import MAX_RECEIVED_DATAGRAM_BYTES

MAX_DATAGRAM_BYTES = 1400
"""Messages of one step share datagrams up to this size, which fits one Ethernet or 802.11 frame."""
MAX_DATAGRAMS_PER_CALL = 64
MAX_BYTES_PER_CALL = 16_384
MAX_FRAMES_PER_CALL = 256
"""Limits of one call of `MavlinkLink.receive`, the first of which ends it, so that a flooded link does not
delay the swarm. The rest stays in the carrier's buffer, which drops what does not fit."""
MAX_DROPPED_PER_CALL = 512
"""Datagrams that one call drops unread at most, which costs little; it then ends likewise."""
_NS_PER_S = 1_000_000_000
_US_PER_S = 1_000_000
_SETUP_SIGNING = common.MAVLINK_MSG_ID_SETUP_SIGNING

A = TypeVar("A")


class Carrier(Protocol[A]):
    """What carries the datagrams of a link; A is the type of its addresses."""

    @property
    def defaults(self) -> Sequence[A]:
        """Addresses that are sent to without having sent anything."""

    def wall_s(self) -> float:
        """Return the wall time for budgets; a constant if simulated time alone counts."""

    def receive(self) -> tuple[bytes, A] | None:
        """Return the next datagram and its sender, without waiting; None without one."""

    def send(self, datagram: bytes | bytearray, address: A) -> None:
        """Send a datagram, which may be lost."""

    def take_unreachable(self, *, look: bool = False) -> Sequence[A]:
        """Return the addresses found to be unreachable since the last call; ``look``: find out first."""

    def trusts(self, sender: A, wall_s: float) -> bool:
        """Whether a datagram of a sender may be read."""

    def may_send(self, address: A, wall_s: float, *, has_sent: bool) -> bool:
        """Whether an address may be sent to; ``has_sent``: it is that of a partner that was trusted."""


class MavlinkLink(Generic[A]):
    """A link that sends to the carrier's default partners and to every partner that has sent to it.

    With a signer it accepts only frames signed with its key, and signs the frames that it sends. With a
    budget it drops datagrams beyond it. ``tap`` receives each frame that is accepted or sent; one that is
    sent to several partners, as the first of them gets it.
    """

    def __init__(
        self,
        carrier: Carrier[A],
        *,
        encoder: Encoder,
        signer: Signer | None = None,
        budget: InputBudget | None = None,
        tap: Callable[[bytes], None] | None = None,
    ) -> None:
        self._carrier = carrier
        self._tap = tap
        self._signer = signer
        self._budget = budget
        self.foreign: A | None = None
        """The first sender whose datagrams were dropped because the carrier does not trust it."""
        self._parser = Parser(signer)
        self.counters = self._parser.counters
        """Counts of rejected input, by cause."""
        self._encoder = encoder
        self._partners: Partners[A, Sequences] = Partners(carrier.defaults, Sequences)

    @property
    def active(self) -> bool:
        """Whether there is a listener; otherwise only heartbeats need to be built."""
        return self._partners.any_listens

    def receive(self, now_us: int) -> list[tuple[int, Message]]:
        """Return messages that have arrived, with their partners' numbers, without waiting.

        The sender of a message becomes a partner, and keeps its number until it is removed. Input beyond
        the limits of one call is left for the next. ``now_us`` is the simulated time, for the budget.
        """
        messages: list[tuple[int, Message]] = []
        carrier = self._carrier
        now, wall_s = self._now(), carrier.wall_s()
        if self._budget is not None:
            self._budget.advance(now_us, round(wall_s * _US_PER_S))
        left_bytes, last_frame = MAX_BYTES_PER_CALL, self._parser.looked_at + MAX_FRAMES_PER_CALL
        left_datagrams, left_drops = MAX_DATAGRAMS_PER_CALL, MAX_DROPPED_PER_CALL
        dropped: set[A] = set()
        """Senders over their budget, which does not grow during the call."""
        while min(left_bytes, left_datagrams, left_drops, last_frame - self._parser.looked_at) > 0:
            received = carrier.receive()
            self._remove_unreachable()  # before a sender that has started again becomes a partner
            if received is None:
                break
            data, address = received
            if address in dropped:
                self.counters.datagrams_over_budget += 1
                left_drops -= 1
                continue
            if not self._admits(address, wall_s, dropped):
                left_drops -= 1
                continue
            left_datagrams -= 1
            left_bytes -= len(data)
            if len(data) > MAX_RECEIVED_DATAGRAM_BYTES:
                self.counters.datagrams_too_long += 1
                continue
            messages += self._parsed(data, address, now)
        return messages

    def _parsed(self, data: bytes, address: A, now: int) -> list[tuple[int, Message]]:
        """Return the messages of a datagram, whose sender becomes a partner if there are any."""
        looked_at = self._parser.looked_at
        received = self._parser.push_datagram(data, now)
        if self._budget is not None:
            self._budget.spend(address, len(received), self._parser.looked_at - looked_at - len(received))
        if not received:
            return []
        number, messages = self._partners.add(address), []
        for message in received:
            if self._tap is not None:
                self._tap(bytes(message.get_msgbuf()))
            if message.get_msgId() == _SETUP_SIGNING:
                self.counters.setup_signing += 1
            else:
                messages.append((number, message))
        return messages

    def send(self, messages: Sequence[tuple[int, Message]]) -> None:
        """Send messages, packed into few datagrams, each to the partner of its number or to BROADCAST.

        BROADCAST includes the default partners, whether they have sent anything or not. Messages to a partner
        that was removed are dropped.
        """
        carrier, wall_s = self._carrier, self._carrier.wall_s()

        def may_send(address: A, /, *, has_sent: bool) -> bool:
            return carrier.may_send(address, wall_s, has_sent=has_sent)

        recipients = self._partners.recipients(may_send) if messages else {}
        packed: list[bytes | None] = [None] * len(messages)
        now = self._now()
        for address, peer in recipients.items():
            datagrams = self._datagrams(messages, peer, packed, now)
            if datagrams:
                self._partners.note_sent(address)  # unless it is reported unreachable, below
            for datagram in datagrams:
                carrier.send(datagram, address)
        self._remove_unreachable(look=True)

    def _admits(self, sender: A, wall_s: float, dropped: set[A]) -> bool:
        """Whether a datagram is to be read; counts it otherwise, and adds a sender over its budget."""
        if not self._carrier.trusts(sender, wall_s):
            self.counters.datagrams_foreign += 1
            self.foreign = self.foreign or sender
            return False
        if self._budget is not None and not self._budget.admits(sender):
            self.counters.datagrams_over_budget += 1
            dropped.add(sender)
            return False
        return True

    def _datagrams(
        self, messages: Sequence[tuple[int, Message]], peer: Peer[Sequences], packed: list[bytes | None],
        now: int,
    ) -> list[bytearray]:  # fmt: skip
        """Datagrams for one partner; ``packed`` caches the frames that were packed for another, or None.

        A frame is packed once, and renumbered where a partner's sequence number differs.
        """
        datagrams: list[bytearray] = []
        sequences, encoder, signer = peer.state, self._encoder, self._signer
        for i, (number, message) in enumerate(messages):
            if number not in {BROADCAST, peer.number}:
                continue
            frame = packed[i]
            is_first = frame is None
            if frame is None:
                frame = packed[i] = encoder.encode_for(message, sequences)
            else:
                frame = sequences.renumber(frame, message.get_msgId())
            if signer is not None:
                frame = signed(frame, message.get_msgId(), signer, now)
            if is_first and self._tap is not None:
                self._tap(frame)
            if not datagrams or len(datagrams[-1]) + len(frame) > MAX_DATAGRAM_BYTES:
                datagrams.append(bytearray())
            datagrams[-1] += frame
        return datagrams

    def _remove_unreachable(self, *, look: bool = False) -> None:
        for address in self._carrier.take_unreachable(look=look):
            self._partners.remove(address)

    def _now(self) -> int:
        """Wall clock in units of signatures; 0 without a signer, which makes it unused."""
        if self._signer is None:
            return 0
        return (time.time_ns() - EPOCH_UNIX_S * _NS_PER_S) // (_NS_PER_S // TICKS_PER_S)

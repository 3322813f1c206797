"""A vehicle's UDP link: MAVLink to and from ground stations and companions. The only I/O of its package.

Whether a partner listens is reported by the kernel: on Linux a datagram to a closed port causes an error that
contains the address. So no timeout is needed, and messages are built only while there is a listener.

A port of the loopback interface can be used by every user of the machine. With `DatagramOwners` a link
communicates there only with sockets of its own user or root.
"""

import contextlib
import socket
import sys
import time
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser, Sequences, signed
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.signing import EPOCH_UNIX_S, TICKS_PER_S, Signer
from foundation.processes.socket_owners import DatagramOwners

Address = tuple[str, int]

MAX_DATAGRAM_BYTES = 1400
"""Messages of one step share datagrams up to this size, which fits one Ethernet frame."""
MAX_PARTNERS = 8
"""A new partner replaces the one that was silent longest, except the default partner."""
BROADCAST = -1
"""As a partner's number: all partners."""
MAX_RECEIVED_DATAGRAM_BYTES = 2_048
"""Longer datagrams are dropped unread: MAVLink senders keep within one Ethernet frame."""
MAX_DATAGRAMS_PER_CALL = 64
MAX_BYTES_PER_CALL = 16_384
MAX_FRAMES_PER_CALL = 256
"""Limits of one call of `UdpLink.receive`, the first of which ends it, so that a flooded link does not delay
the swarm. The rest stays in the kernel's buffer, which drops what does not fit."""
MAX_DROPPED_PER_CALL = 512
"""Datagrams that one call drops unread at most, which costs little; it then ends likewise."""
_IP_RECVERR = 11  # linux/in.h; not in the socket module of CPython 3.11
_NS_PER_S = 1_000_000_000
_US_PER_S = 1_000_000
_SETUP_SIGNING = common.MAVLINK_MSG_ID_SETUP_SIGNING


class _Peer:
    def __init__(self, number: int) -> None:
        self.number = number
        self.sequences = Sequences()


class UdpLink:
    """A non-blocking UDP socket that sends to a default partner and to every partner that has sent to it.

    With a signer it accepts only frames signed with its key, and signs the frames that it sends. With
    ``owners`` it communicates, on this machine, only with sockets that these trust. With a budget it drops
    datagrams beyond it.
    """

    def __init__(
        self,
        *,
        host: str,
        local_port: int,
        remote_port: int,
        encoder: Encoder,
        remote_host: str | None = None,
        signer: Signer | None = None,
        owners: DatagramOwners | None = None,
        budget: InputBudget | None = None,
        tap: Callable[[bytes], None] | None = None,
    ) -> None:
        """Bind ``host:local_port`` (0: any free port); the default partner is at ``remote_port`` (0: none).

        Its address is ``remote_host``, by default ``host``; both are IPv4 addresses. ``tap`` receives each
        frame that is accepted or sent; one that is sent to several partners, as the first of them gets it.
        Raises OSError if the port is in use.
        """
        self._tap = tap
        self._signer = signer
        self._owners, self._budget = owners, budget
        self.foreign: Address | None = None
        """The first sender whose datagrams were dropped because of their owner."""
        self._parser = Parser(signer)
        self.counters = self._parser.counters
        """Counts of rejected input, by cause."""
        self._encoder = encoder
        self._default: Address | None = (remote_host or host, remote_port) if remote_port else None
        self._default_peer = _Peer(BROADCAST)
        """Numbered while it is reachable and has sent something; its sequence numbers never restart."""
        self._default_listens = False
        self._partners: dict[Address, _Peer] = {}
        """By address; the most recent sender is last."""
        self._next_number = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.settimeout(0.0)  # non-blocking
            if sys.platform == "linux":
                self._socket.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
            self._socket.bind((host, local_port))
        except OSError:
            self._socket.close()
            raise

    @property
    def local_port(self) -> int:
        """The port that the link is bound to."""
        port: int = self._socket.getsockname()[1]
        return port

    @property
    def active(self) -> bool:
        """Whether there is a listener; otherwise only heartbeats need to be built."""
        return self._default_listens or bool(self._partners)

    def fileno(self) -> int:
        """Return the socket's descriptor, for select and poll."""
        return self._socket.fileno()

    def receive(self, now_us: int) -> list[tuple[int, Message]]:
        """Return messages that have arrived, with their partners' numbers, without waiting.

        The sender of a message becomes a partner, and keeps its number until it is removed. Input beyond
        the limits of one call is left for the next. ``now_us`` is the simulated time, for the budget.
        """
        messages: list[tuple[int, Message]] = []
        now, wall_s = self._now(), time.monotonic()
        if self._budget is not None:
            self._budget.advance(now_us, round(wall_s * _US_PER_S))
        left_bytes, last_frame = MAX_BYTES_PER_CALL, self._parser.looked_at + MAX_FRAMES_PER_CALL
        left_datagrams, left_drops = MAX_DATAGRAMS_PER_CALL, MAX_DROPPED_PER_CALL
        dropped: set[Address] = set()
        """Senders over their budget, which does not grow during the call."""
        while min(left_bytes, left_datagrams, left_drops, last_frame - self._parser.looked_at) > 0:
            try:
                # the kernel truncates datagrams, so one extra byte detects those that are too long
                data, address = self._socket.recvfrom(MAX_RECEIVED_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            except OSError:  # an earlier datagram was refused; the error queue has its address
                self._remove_unreachable()
                left_datagrams -= 1
                continue
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
            looked_at = self._parser.looked_at
            received = self._parser.push_datagram(data, now)
            if self._budget is not None:
                self._budget.spend(address, len(received), self._parser.looked_at - looked_at - len(received))
            if received:
                number = self._add_partner(address)
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

        BROADCAST includes the default partner, whether it has sent anything or not. Messages to a partner
        that was removed are dropped.
        """
        recipients = self._recipients() if messages else {}
        packed: list[bytes | None] = [None] * len(messages)
        now = self._now()
        for address, peer in recipients.items():
            datagrams = self._datagrams(messages, peer, packed, now)
            if datagrams and address == self._default:
                self._default_listens = True  # unless the kernel reports it unreachable, below
            for datagram in datagrams:
                self._send_to(datagram, address)
        self._remove_unreachable()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _admits(self, sender: Address, wall_s: float, dropped: set[Address]) -> bool:
        """Whether a datagram is to be read; counts it otherwise, and adds a sender over its budget."""
        if self._owners is not None and not self._owners.trusts(sender, wall_s, wall_since_s=wall_s):
            self.counters.datagrams_foreign += 1
            self.foreign = self.foreign or sender
            return False
        if self._budget is not None and not self._budget.admits(sender):
            self.counters.datagrams_over_budget += 1
            dropped.add(sender)
            return False
        return True

    def _recipients(self) -> dict[Address, _Peer]:
        """Return the partners to which messages are sent now, with the default partner."""
        recipients, default, owners = dict(self._partners), self._default, self._owners
        if owners is not None:
            wall_s = time.monotonic()
            for address in self._partners:
                if owners.is_foreign(address, wall_s):
                    del recipients[address]
            if default is not None and default not in self._partners and not owners.trusts(default, wall_s):
                default, self._default_listens = None, False
        if default is not None and default not in self._partners:
            recipients[default] = self._default_peer
        return recipients

    def _datagrams(
        self, messages: Sequence[tuple[int, Message]], peer: _Peer, packed: list[bytes | None], now: int
    ) -> list[bytearray]:
        """Datagrams for one partner; ``packed`` caches the frames that were packed for another, or None.

        A frame is packed once, and renumbered where a partner's sequence number differs.
        """
        datagrams: list[bytearray] = []
        sequences, encoder, signer = peer.sequences, self._encoder, self._signer
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

    def _send_to(self, datagram: bytearray, address: Address) -> None:
        for _ in range(2):
            try:
                self._socket.sendto(datagram, address)
            except BlockingIOError:
                return  # the buffer is full; the datagram is lost
            except OSError:
                # the error is of an earlier datagram, possibly to another partner; this one was not sent
                self._remove_unreachable()
                continue
            return

    def _add_partner(self, address: Address) -> int:
        peer = self._partners.pop(address, None)
        if peer is None:
            peer = self._default_peer if address == self._default else _Peer(BROADCAST)
            if peer.number == BROADCAST:
                peer.number = self._next_number
                self._next_number += 1
        self._partners[address] = peer
        if len(self._partners) > MAX_PARTNERS:
            del self._partners[next(other for other in self._partners if other != self._default)]
        return peer.number

    def _remove_unreachable(self) -> None:
        """Remove the partners that the kernel's error queue reports as unreachable."""
        if sys.platform != "linux":
            return
        with contextlib.suppress(BlockingIOError):
            while True:
                _, _, _, address = self._socket.recvmsg(1, 512, socket.MSG_ERRQUEUE)
                self._partners.pop(address, None)
                if address == self._default:
                    self._default_listens = False
                    self._default_peer.number = BROADCAST  # the next partner there gets a new number

    def _now(self) -> int:
        """Wall clock in units of signatures; 0 without a signer, which makes it unused."""
        if self._signer is None:
            return 0
        return (time.time_ns() - EPOCH_UNIX_S * _NS_PER_S) // (_NS_PER_S // TICKS_PER_S)

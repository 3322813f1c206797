"""The UDP edge of a vehicle: MAVLink to and from ground stations and companions. The only I/O of its package.

Whether anybody listens is learned from the kernel: on Linux a datagram to a closed port comes back as an
error that names the address. So no clock is needed for that, and nothing is formed for nobody.
"""

import contextlib
import socket
import sys
import time
from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message, Parser, Sequences, signed
from autopilot.mavlink.counters import Counters
from autopilot.mavlink.signing import EPOCH_UNIX_S, TICKS_PER_S, Signer

Address = tuple[str, int]

MAX_DATAGRAM_BYTES = 1400
"""Messages of one step share datagrams up to this size, which fits one Ethernet frame."""
MAX_PARTNERS = 8
"""The partner that was silent longest gives way to a ninth, but never the default one."""
EVERYBODY = -1
"""In place of a partner's number: all of them."""
MAX_RECEIVED_DATAGRAM_BYTES = 2_048
"""What is longer is dropped unread: senders of MAVLink keep to what fits one Ethernet frame."""
MAX_DATAGRAMS_PER_CALL = 64
MAX_BYTES_PER_CALL = 16_384
MAX_FRAMES_PER_CALL = 256
"""Whichever is reached first ends a call of `UdpLink.receive`, for a swarm must not fly late because somebody
talks much. The rest waits in the kernel, which drops what it has no room for."""
_IP_RECVERR = 11  # linux/in.h; the socket module of CPython 3.11 does not name it
_NS_PER_S = 1_000_000_000
_SETUP_SIGNING = common.MAVLINK_MSG_ID_SETUP_SIGNING


class _Peer:
    """Whoever is at one address."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.sequences = Sequences()


class UdpLink:
    """A non-blocking UDP socket that speaks to a default partner and to everybody who has spoken to it.

    With a signer it hears only what is signed by its key, and signs what it sends.
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
    ) -> None:
        """Bind ``host:local_port`` (0: any free port) and speak to ``remote_port`` (0: nobody) first.

        That is on ``remote_host``, which is ``host`` if it is not given; both are IPv4 addresses. Raises
        OSError when the port is taken.
        """
        self._signer = signer
        self._parser = Parser(signer)
        self._encoder = encoder
        self._default: Address | None = (remote_host or host, remote_port) if remote_port else None
        self._default_peer = _Peer(EVERYBODY)
        """Numbered while it is known to be there and has spoken; its sequence numbers go on for good."""
        self._default_listens = False
        self._partners: dict[Address, _Peer] = {}
        """Ordered: who spoke last is last."""
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
        """Somebody listens; only then is more than a heartbeat worth forming."""
        return self._default_listens or bool(self._partners)

    @property
    def bad_bytes(self) -> int:
        """Received bytes that belonged to no message."""
        return self._parser.bad_bytes

    @property
    def counters(self) -> Counters:
        """What was not taken, by cause."""
        return self._parser.counters

    def fileno(self) -> int:
        """For select and its kin."""
        return self._socket.fileno()

    def receive(self) -> list[tuple[int, Message]]:
        """Messages that have arrived, without waiting, with the numbers of the partners that they are from.

        Whoever sends one becomes a partner, and keeps its number until it is forgotten. What is too much for
        one call is left for the next.
        """
        messages: list[tuple[int, Message]] = []
        now = self._now()
        left_bytes, last_frame = MAX_BYTES_PER_CALL, self._parser.looked_at + MAX_FRAMES_PER_CALL
        for _ in range(MAX_DATAGRAMS_PER_CALL):
            if left_bytes <= 0 or self._parser.looked_at >= last_frame:
                break
            try:
                # the kernel cuts off the rest, so one byte more tells what was too long
                data, address = self._socket.recvfrom(MAX_RECEIVED_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            except OSError:  # a datagram that was sent came back as an error, which names its address
                self._forget_refusing()
                continue
            left_bytes -= len(data)
            if len(data) > MAX_RECEIVED_DATAGRAM_BYTES:
                self.counters.datagrams_too_long += 1
                continue
            received = self._parser.push_datagram(data, now)
            if received:
                number = self._remember(address)
                for message in received:
                    if message.get_msgId() == _SETUP_SIGNING:
                        self.counters.setup_signing += 1
                    else:
                        messages.append((number, message))
        return messages

    def send(self, messages: Sequence[tuple[int, Message]]) -> None:
        """Send messages, packed into few datagrams, each to the partner of its number or to EVERYBODY.

        The default partner is one of everybody whether it has spoken or not. What is for a partner that is
        gone is dropped.
        """
        recipients = dict(self._partners)
        if self._default is not None:
            recipients.setdefault(self._default, self._default_peer)
        packed: list[bytes | None] = [None] * len(messages)
        now = self._now()
        for address, peer in recipients.items():
            datagrams = self._datagrams(messages, peer, packed, now)
            if datagrams and address == self._default:
                self._default_listens = True  # until the kernel says otherwise, below
            for datagram in datagrams:
                self._send_to(datagram, address)
        self._forget_refusing()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _datagrams(
        self, messages: Sequence[tuple[int, Message]], peer: _Peer, packed: list[bytes | None], now: int
    ) -> list[bytearray]:
        """Datagrams for one partner; ``packed`` has the frames that another's made before, or None.

        A frame is packed once, and only numbered anew where a partner's count is another.
        """
        datagrams: list[bytearray] = []
        sequences, encoder, signer = peer.sequences, self._encoder, self._signer
        for i, (number, message) in enumerate(messages):
            if number not in {EVERYBODY, peer.number}:
                continue
            frame = packed[i]
            if frame is None:
                frame = packed[i] = encoder.encode_for(message, sequences)
            else:
                frame = sequences.renumber(frame, message.get_msgId())
            if signer is not None:
                frame = signed(frame, message.get_msgId(), signer, now)
            if not datagrams or len(datagrams[-1]) + len(frame) > MAX_DATAGRAM_BYTES:
                datagrams.append(bytearray())
            datagrams[-1] += frame
        return datagrams

    def _send_to(self, datagram: bytearray, address: Address) -> None:
        for _ in range(2):
            try:
                self._socket.sendto(datagram, address)
            except BlockingIOError:
                return  # a full buffer loses a datagram, as UDP may
            except OSError:
                # the error belongs to an earlier datagram, maybe another partner's, and this one was not sent
                self._forget_refusing()
                continue
            return

    def _remember(self, address: Address) -> int:
        peer = self._partners.pop(address, None)
        if peer is None:
            peer = self._default_peer if address == self._default else _Peer(EVERYBODY)
            if peer.number == EVERYBODY:
                peer.number = self._next_number
                self._next_number += 1
        self._partners[address] = peer
        if len(self._partners) > MAX_PARTNERS:
            del self._partners[next(known for known in self._partners if known != self._default)]
        return peer.number

    def _forget_refusing(self) -> None:
        """Read from the error queue which addresses have no listener."""
        if sys.platform != "linux":
            return
        with contextlib.suppress(BlockingIOError):
            while True:
                _, _, _, address = self._socket.recvmsg(1, 512, socket.MSG_ERRQUEUE)
                self._partners.pop(address, None)
                if address == self._default:
                    self._default_listens = False
                    self._default_peer.number = EVERYBODY  # who comes next begins anew

    def _now(self) -> int:
        """Wall clock in the units of signatures; where nothing is signed nobody asks."""
        if self._signer is None:
            return 0
        return (time.time_ns() - EPOCH_UNIX_S * _NS_PER_S) // (_NS_PER_S // TICKS_PER_S)

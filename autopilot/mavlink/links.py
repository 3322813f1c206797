"""The UDP edge of a vehicle: MAVLink to and from ground stations and companions. The only I/O of its package.

Whether anybody listens is learned from the kernel: on Linux a datagram to a closed port comes back as an
error that names the address. So no clock is needed, and nothing is formed for nobody.
"""

import contextlib
import socket
import sys
from collections.abc import Iterable, Sequence

from autopilot.mavlink.codec import Encoder, Message, Parser

Address = tuple[str, int]

MAX_DATAGRAM_BYTES = 1400
"""Messages of one step share datagrams up to this size, which fits one Ethernet frame."""
MAX_PARTNERS = 8
"""The partner that was silent longest gives way to a ninth."""
EVERYBODY = -1
"""In place of a partner's number: all of them."""
MAX_DATAGRAMS_PER_CALL = 64
_IP_RECVERR = 11  # linux/in.h; the socket module of CPython 3.11 does not name it
_LARGEST_DATAGRAM_BYTES = 65_535


class UdpLink:
    """A non-blocking UDP socket that speaks to a default partner and to everybody who has spoken to it."""

    def __init__(self, *, host: str, local_port: int, remote_port: int, encoder: Encoder) -> None:
        """Bind ``host:local_port`` (0: any free port) and speak to ``host:remote_port`` (0: nobody) first.

        Raises OSError when the port is taken.
        """
        self._parser = Parser()
        self._encoder = encoder
        self._default: Address | None = (host, remote_port) if remote_port else None
        self._default_listens = False
        self._partners: dict[Address, int] = {}
        """Their numbers. Ordered: who spoke last is last."""
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

    def fileno(self) -> int:
        """For select and its kin."""
        return self._socket.fileno()

    def receive(self) -> list[tuple[int, Message]]:
        """Messages that have arrived, without waiting, with the numbers of the partners that they are from.

        Whoever sends one becomes a partner, and keeps its number until it is forgotten.
        """
        messages: list[tuple[int, Message]] = []
        for _ in range(MAX_DATAGRAMS_PER_CALL):
            try:
                data, address = self._socket.recvfrom(_LARGEST_DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                self._forget_refusing()
                continue
            received = self._parser.push_datagram(data)
            if received:
                number = self._remember(address)
                messages += [(number, message) for message in received]
        return messages

    def send(self, messages: Sequence[tuple[int, Message]]) -> None:
        """Send messages, packed into few datagrams, each to the partner of its number or to EVERYBODY.

        The default partner is one of everybody whether it has spoken or not. What is for a partner that is
        gone is dropped.
        """
        for_all = all(number == EVERYBODY for number, _ in messages)
        packed = self._pack(message for _, message in messages) if for_all else None
        recipients = dict(self._partners)
        if self._default is not None:
            recipients.setdefault(self._default, EVERYBODY)
        for address, own_number in recipients.items():
            datagrams = (
                self._pack(message for number, message in messages if number in {EVERYBODY, own_number})
                if packed is None
                else packed
            )
            if datagrams and address == self._default:
                self._default_listens = True  # until the kernel says otherwise, below
            for datagram in datagrams:
                self._send_to(datagram, address)
        self._forget_refusing()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _pack(self, messages: Iterable[Message]) -> list[bytearray]:
        datagrams: list[bytearray] = []
        for message in messages:
            frame = self._encoder.encode(message)
            if not datagrams or len(datagrams[-1]) + len(frame) > MAX_DATAGRAM_BYTES:
                datagrams.append(bytearray())
            datagrams[-1] += frame
        return datagrams

    def _send_to(self, datagram: bytearray, address: Address) -> None:
        for _ in range(2):
            try:
                self._socket.sendto(datagram, address)
            except ConnectionRefusedError:
                # the error belongs to an earlier datagram, maybe another partner's, and this one was not sent
                self._forget_refusing()
                continue
            except OSError:
                pass  # a full buffer or an unreachable network loses a datagram, as UDP may
            return

    def _remember(self, address: Address) -> int:
        number = self._partners.pop(address, None)
        if number is None:
            number = self._next_number
            self._next_number += 1
        self._partners[address] = number
        if len(self._partners) > MAX_PARTNERS:
            del self._partners[next(iter(self._partners))]
        return number

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

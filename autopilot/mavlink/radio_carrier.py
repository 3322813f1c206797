"""Datagrams of a link as frames of the vehicle's radio. No I/O.

A datagram is one unicast frame to a ground station, from and to UDP port `TELEMETRY_PORT`, with ACK and
retries. Nothing reports over the air that a station's program has ended, so no station is unreachable.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from netsim.wire.messages import Delivery, RxItem, Sent, TxItem, Unicast

TELEMETRY_PORT = 14_550
"""UDP port of MAVLink on the radio, which applications of a vehicle with such a link cannot use."""
FIRST_SEQUENCE = 2**62
"""Sequence number of the link's first frame; those of the applications count from 0."""
_MOST_WAITING = 1_024
"""Received datagrams that wait for the link; the oldest are dropped."""


@dataclass(slots=True)
class FrameCounts:
    """Counts of the frames between a vehicle and a ground station, at one end."""

    sent: int = 0
    """Handed over to the radio, which has not reported all of them yet."""
    acknowledged: int = 0
    lost: int = 0
    """Given up after the last retry, or too long in the queue, or not taken by it."""
    received: int = 0

    def add(self, sent: Sent) -> None:
        """Count the outcome of a frame."""
        if sent.status == "acknowledged":
            self.acknowledged += 1
        else:
            self.lost += 1


class RadioCarrier:
    """The carrier of a link to ground stations, whose numbers ``stations`` has by their names."""

    def __init__(self, stations: Mapping[str, int]) -> None:
        self.counts = {name: FrameCounts() for name in stations}
        """By the station's name."""
        self._counts = {station: self.counts[name] for name, station in stations.items()}
        self.defaults = tuple(stations.values())
        self.now_us = 0
        """Simulated time of the frames that are sent next."""
        self.foreign = 0
        """Number of datagrams to the port from other stations, which are dropped."""
        self._received: deque[tuple[bytes, int]] = deque(maxlen=_MOST_WAITING)
        self._items: list[TxItem] = []
        self._sequence = FIRST_SEQUENCE

    @property
    def has_received(self) -> bool:
        """Whether there are datagrams for `receive`."""
        return bool(self._received)

    def take_in(self, items: Sequence[RxItem]) -> list[RxItem]:
        """Take what is of the link among the items that the radio returned; return the others."""
        others: list[RxItem] = []
        for item in items:
            if isinstance(item, Delivery) and item.port == TELEMETRY_PORT:
                counts = self._counts.get(item.source)
                if counts is None:
                    self.foreign += 1
                    continue
                counts.received += 1
                self._received.append((item.payload, item.source))
            elif isinstance(item, Sent) and item.seq >= FIRST_SEQUENCE:
                self._counts[item.destination].add(item)
            else:
                others.append(item)
        return others

    def take_out(self) -> tuple[TxItem, ...]:
        """Return the frames to be sent, and forget them."""
        items, self._items = tuple(self._items), []
        return items

    # ---- see `autopilot.mavlink.links.Carrier`

    @staticmethod
    def wall_s() -> float:
        """Return 0: budgets follow simulated time, so that a flight depends on nothing else."""
        return 0.0

    def receive(self) -> tuple[bytes, int] | None:
        """Return the next datagram and the number of the station that sent it."""
        return self._received.popleft() if self._received else None

    def send(self, datagram: bytes | bytearray, address: int) -> None:
        """Hand over a datagram for a station."""
        self._items.append(
            Unicast(
                seq=self._sequence, at_us=self.now_us, destination=address, payload=bytes(datagram),
                port=TELEMETRY_PORT,
            )
        )  # fmt: skip
        self._sequence += 1
        self._counts[address].sent += 1

    @staticmethod
    def take_unreachable(*, look: bool = False) -> Sequence[int]:  # noqa: ARG004  as any carrier
        """Return none."""
        return ()

    @staticmethod
    def trusts(sender: int, wall_s: float) -> bool:  # noqa: ARG004  as any carrier
        """Return True: datagrams of other stations than the link's were dropped."""
        return True

    @staticmethod
    def may_send(address: int, wall_s: float, *, has_sent: bool) -> bool:  # noqa: ARG004  as any carrier
        """Return True."""
        return True

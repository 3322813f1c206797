"""Datagrams of a link as frames of the vehicle's radio. No I/O.

A datagram is one unicast frame to a ground station, from and to UDP port `TELEMETRY_PORT`, with ACK and
retries. Nothing reports over the air that a station's program has ended, so no station is unreachable.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from autopilot.mavlink.station_carrier import FIRST_SEQUENCE, StationCarrier
from netsim.wire.messages import Delivery, RxItem, Sent, Unicast

TELEMETRY_PORT = 14_550
"""UDP port of MAVLink on the radio, which applications of a vehicle with such a link cannot use."""


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


class RadioCarrier(StationCarrier):
    """The carrier of a link to ground stations, whose numbers ``stations`` has by their names."""

    def __init__(self, stations: Mapping[str, int]) -> None:
        super().__init__(tuple(stations.values()))
        self.counts = {name: FrameCounts() for name in stations}
        """By the station's name."""
        self._counts = {station: self.counts[name] for name, station in stations.items()}

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

    def send(self, datagram: bytes | bytearray, address: int) -> None:
        """Hand over a datagram for a station."""
        self._queue(
            Unicast(
                seq=self._sequence, at_us=self.now_us, destination=address, payload=bytes(datagram),
                port=TELEMETRY_PORT,
            )
        )  # fmt: skip
        self._counts[address].sent += 1

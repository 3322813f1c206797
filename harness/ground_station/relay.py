"""Datagrams of programs as frames of a ground station's radio, and the frames it receives as datagrams.

One datagram is one unicast frame. No I/O.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict

from autopilot.mavlink.radio_carrier import TELEMETRY_PORT, FrameCounts
from netsim.wire.messages import MAX_PAYLOAD_BYTES, Delivery, RxItem, Sent, Unicast


class Relay:
    """The radio of one ground station and its links to ``vehicles`` vehicles."""

    def __init__(self, vehicles: int) -> None:
        self._counts = [FrameCounts() for _ in range(vehicles)]
        self.too_long = 0
        """Datagrams of programs that exceed a frame, which are dropped."""
        self._sequence = 0

    def frame(self, vehicle: int, datagram: bytes) -> Unicast | None:
        """Return the frame with a program's datagram for a vehicle; None if it does not fit into one."""
        if len(datagram) > MAX_PAYLOAD_BYTES:
            self.too_long += 1
            return None
        self._sequence += 1
        self._counts[vehicle].sent += 1
        # time 0: at once, as for all guests
        return Unicast(
            seq=self._sequence, at_us=0, destination=vehicle, payload=datagram, port=TELEMETRY_PORT
        )

    def on_refused(self, frames: Iterable[Unicast]) -> None:
        """Count frames that the emulator has not taken."""
        for frame in frames:
            self._counts[frame.destination].lost += 1

    def datagrams(self, items: Sequence[RxItem]) -> Iterator[tuple[int, bytes]]:
        """Yield the vehicle and the content of each datagram among the items that the radio returned."""
        vehicles = range(len(self._counts))
        for item in items:
            match item:
                case Delivery() if item.port == TELEMETRY_PORT and item.source in vehicles:
                    self._counts[item.source].received += 1
                    yield item.source, item.payload
                case Sent() if item.destination in vehicles:
                    self._counts[item.destination].add(item)
                case _:
                    pass

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Counts of frames by vehicle."""
        return {f"uav {i}": asdict(counts) for i, counts in enumerate(self._counts)}

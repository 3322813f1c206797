"""Datagrams of programs as frames of a ground station's radio, and the frames it receives as datagrams.

One datagram is one unicast frame. No I/O.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict

from autopilot.mavlink.radio_carrier import TELEMETRY_PORT, FrameCounts
from harness.ground_station.send_window import SendWindow
from netsim.wire.messages import MAX_PAYLOAD_BYTES, Delivery, RxBatch, Sent, Unicast


class Relay:
    """The radio of one ground station and its links to ``vehicles`` vehicles.

    ``queue_frames`` and ``queue_lifetime_us`` are those of the radio's queue.
    """

    def __init__(self, vehicles: int, *, queue_frames: int, queue_lifetime_us: int) -> None:
        self._counts = [FrameCounts() for _ in range(vehicles)]
        self._window = SendWindow(vehicles, queue_frames=queue_frames, queue_lifetime_us=queue_lifetime_us)
        self._too_long = 0
        self._sequence = 0

    def put(self, vehicle: int, datagram: bytes) -> None:
        """Accept a program's datagram for a vehicle; one that does not fit into a frame is dropped."""
        if len(datagram) > MAX_PAYLOAD_BYTES:
            self._too_long += 1
        else:
            self._window.put(vehicle, datagram)

    def take(self) -> list[Unicast]:
        """Return the frames that the radio may have now."""
        frames = []
        while (due := self._window.take()) is not None:
            vehicle, datagram = due
            self._sequence += 1
            self._counts[vehicle].sent += 1
            self._window.on_sent(vehicle, self._sequence)
            # time 0: at once, as for all guests
            frames.append(
                Unicast(
                    seq=self._sequence, at_us=0, destination=vehicle, payload=datagram, port=TELEMETRY_PORT
                )
            )
        return frames

    def on_refused(self, frames: Iterable[Unicast]) -> None:
        """Count frames that the emulator has not taken."""
        for frame in frames:
            self._counts[frame.destination].lost += 1
            self._window.on_reported(frame.destination, frame.seq)

    def datagrams(self, batch: RxBatch) -> Iterator[tuple[int, bytes]]:
        """Yield the vehicle and the content of each datagram in what the radio returned."""
        vehicles = range(len(self._counts))
        for item in batch.items:
            match item:
                case Delivery() if item.port == TELEMETRY_PORT and item.source in vehicles:
                    self._counts[item.source].received += 1
                    yield item.source, item.payload
                case Sent() if item.destination in vehicles:
                    self._counts[item.destination].add(item)
                    self._window.on_reported(item.destination, item.seq)
                case _:
                    pass
        self._window.advance(batch.release_us)

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Counts of frames by vehicle."""
        return {f"uav {i}": asdict(counts) for i, counts in enumerate(self._counts)}

    @property
    def dropped(self) -> dict[str, int]:
        """Numbers of datagrams of programs that did not become frames, by cause."""
        return {"datagrams_too_long": self._too_long, "datagrams_overtaken": self._window.overtaken}

"""Datagrams of programs as bytes of a ground station's serial modems, and what these pass on as datagrams.

The station has a modem for each vehicle. A datagram to a program is a whole MAVLink frame, a RADIO_STATUS of
the modem, or what else has arrived. No I/O.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict

from autopilot.mavlink.serial_carrier import SerialCounts, modem_encoder, radio_status
from netsim.wire.messages import MAX_PAYLOAD_BYTES, RxBatch, SerialBytes, SerialReceived, SerialReport


class SerialRelay:
    """The serial modems of one ground station and its links to ``vehicles`` vehicles."""

    def __init__(self, vehicles: int) -> None:
        self._counts = [SerialCounts() for _ in range(vehicles)]
        self._encoders = [modem_encoder() for _ in range(vehicles)]
        self._too_long = 0
        self._sequence = 0
        self._items: list[SerialBytes] = []

    def put(self, vehicle: int, datagram: bytes) -> None:
        """Accept a program's datagram for the modem of a vehicle; one that is too long is dropped."""
        if len(datagram) > MAX_PAYLOAD_BYTES:
            self._too_long += 1
            return
        self._sequence += 1
        self._counts[vehicle].sent_bytes += len(datagram)
        # time 0: at once, as for all guests
        self._items.append(SerialBytes(seq=self._sequence, at_us=0, peer=vehicle, payload=datagram))

    def take(self) -> list[SerialBytes]:
        """Return what was put, and forget it: the modem's own buffer bounds what waits."""
        items, self._items = self._items, []
        return items

    def on_refused(self, frames: Iterable[SerialBytes]) -> None:
        """Take back the counts of what the emulator has not taken."""
        for frame in frames:
            self._counts[frame.peer].sent_bytes -= len(frame.payload)

    def datagrams(self, batch: RxBatch) -> Iterator[tuple[int, bytes]]:
        """Yield the vehicle and the content of each datagram for programs."""
        for item in batch.items:
            match item:
                case SerialReceived():
                    self._counts[item.peer].received_bytes += len(item.payload)
                    yield item.peer, item.payload
                case SerialReport():
                    self._counts[item.peer].radio_status += 1
                    yield item.peer, self._encoders[item.peer].encode(radio_status(item))
                case _:
                    pass

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Counts of bytes and reports by vehicle."""
        return {f"uav {i}": asdict(counts) for i, counts in enumerate(self._counts)}

    @property
    def dropped(self) -> dict[str, int]:
        """Numbers of datagrams of programs that were not written to a modem, by cause."""
        return {"datagrams_too_long": self._too_long}

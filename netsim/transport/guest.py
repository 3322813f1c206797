"""A station whose host is any program, in its own time: a ground station, a jammer, a protocol under test.

    with Guest("tcp/127.0.0.1:7447", name="ground") as radio:
        radio.broadcast(b"hello")
        for item in radio.receive(timeout_s=1.0):
            print(item)

The scenario says where the guest stands (``radio.guests``). What it sends goes on the air as soon as it
comes, so such a run is not repeatable, and its manifest says so.
"""

import queue
from types import TracebackType
from typing import Self

from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.lockstep_radio import RadioLost, directory_key
from netsim.transport.zenoh_session import Transport
from netsim.wire.messages import (
    MAX_PAYLOAD_BYTES,
    MAX_STATION,
    Broadcast,
    Directory,
    DirectoryRequest,
    FtmRequest,
    RxBatch,
    RxItem,
    TxItem,
    Unicast,
    decode,
    encode,
)

DIRECTORY_LIMIT_S = 5.0


class Guest:
    """One guest's radio; for one thread. Close it, or use it as a context.

    Raises TransportError if nobody listens at the endpoint, RadioLost if that is no run's radio or there is
    no guest of that name. Of two programs under one name the first gets the deliveries. What is sent raises
    RadioLost if the emulator is gone and ValueError for what no radio can send.
    """

    def __init__(self, endpoint: str, *, name: str) -> None:
        self._transport = Transport.connect(endpoint)
        try:
            self.directory = self._ask_directory(endpoint)
            """The run and its stations."""
            self.station = _number(self.directory, name)
            """Its number on the channel."""
            self.now_us = 0
            """Simulated time up to which `receive` has told what arrived."""
            self._seq = 0
            self._batches: queue.SimpleQueue[RxBatch] = queue.SimpleQueue()
            self._radio = AsynchronousRadio(
                self._transport,
                run_id=self.directory.run_id,
                station=self.station,
                put=self._batches.put,
            )
        except BaseException:
            self._transport.close()
            raise

    def _ask_directory(self, endpoint: str) -> Directory:
        asker = self._transport.asker(directory_key("*"), timeout_s=DIRECTORY_LIMIT_S)
        answer = asker.ask(encode(DirectoryRequest())).answer()
        directory = None if answer is None else decode(Directory, answer)
        if directory is None:
            raise RadioLost(f"{endpoint}: no radio of this version answers there")
        return directory

    def broadcast(self, payload: bytes) -> int:
        """Send a datagram to every station in range; returns its sequence number."""
        return self._send(Broadcast(seq=self._seq + 1, at_us=0, payload=_checked(payload)))

    def unicast(self, destination: int, payload: bytes) -> int:
        """Send a datagram to one station; a `Sent` with the returned number will come."""
        item = Unicast(
            seq=self._seq + 1, at_us=0, destination=_station(destination), payload=_checked(payload)
        )
        return self._send(item)

    def request_ftm(self, peer: int) -> int:
        """Range to a station; an `FtmResult` with the returned number will come."""
        return self._send(FtmRequest(seq=self._seq + 1, at_us=0, peer=_station(peer)))

    def receive(self, *, timeout_s: float) -> list[RxItem]:
        """Take what has arrived; wait for something until the time-out of wall time, then give an empty list.

        Raises RadioLost if nothing has come and the emulator is gone.
        """
        items: list[RxItem] = []
        try:
            batch = self._batches.get(timeout=timeout_s)
            while True:
                self.now_us = batch.release_us
                items.extend(batch.items)
                batch = self._batches.get_nowait()
        except queue.Empty:
            if not items and not self._transport.connected:
                raise RadioLost(f"station {self.station}: the 802.11 emulator is gone") from None
            return items

    def close(self) -> None:
        """Leave the channel; harmless when repeated."""
        self._transport.close()

    def _send(self, item: TxItem) -> int:
        self._radio.hand_over((item,))
        self._seq = item.seq
        return item.seq

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _checked(payload: object) -> bytes:
    if not isinstance(payload, bytes) or len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a datagram is at most {MAX_PAYLOAD_BYTES} bytes, not {payload!r:.40}")
    return payload


def _station(number: int) -> int:
    if not 0 <= number <= MAX_STATION:
        raise ValueError(f"a station's number is 0 to {MAX_STATION}, not {number}")
    return number


def _number(directory: Directory, name: str) -> int:
    if name not in directory.guests:
        known = ", ".join(directory.guests) or "none"
        raise RadioLost(f"there is no guest {name!r} on this channel; its guests: {known}")
    return directory.vehicles + directory.guests.index(name)

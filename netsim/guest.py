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

from netsim.radio import ANSWER_LIMIT_S, Inbox, RadioLost, directory_key, receive_key, transmit_key
from netsim.transport import Transport
from netsim.wire.messages import (
    Ack,
    Broadcast,
    Directory,
    DirectoryRequest,
    FtmRequest,
    RxBatch,
    RxItem,
    TxBatch,
    TxItem,
    Unicast,
    decode,
    encode,
)

DIRECTORY_LIMIT_S = 5.0


class Guest:
    """One guest's radio; for one thread. Close it, or use it as a context.

    Raises TransportError if nobody listens at the endpoint, RadioLost if that is no run's radio or there is
    no guest of that name.
    """

    def __init__(self, endpoint: str, *, name: str) -> None:
        self._transport = Transport.connect(endpoint)
        try:
            self.directory = self._ask_directory(endpoint)
            """The run and its stations."""
            self.station = _station(self.directory, name)
            """Its number on the channel."""
            self.now_us = 0
            """Simulated time up to which `receive` has told what arrived."""
            self._seq = 0
            self._batches: queue.SimpleQueue[RxBatch] = queue.SimpleQueue()
            self._inbox = Inbox(self.station, self._batches.put)
            run_id = self.directory.run_id
            self._transport.serve(receive_key(run_id, self.station), self._inbox.take)
            self._asker = self._transport.asker(transmit_key(run_id), timeout_s=ANSWER_LIMIT_S)
            self._hand_over()  # acknowledged only after the declaration above is known: see RadioClient
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
        """Send a datagram to every station in range; returns its sequence number. Raises RadioLost."""
        self._seq += 1
        self._hand_over(Broadcast(seq=self._seq, at_us=0, payload=payload))
        return self._seq

    def unicast(self, destination: int, payload: bytes) -> int:
        """Send a datagram to one station; a `Sent` with the returned number will come. Raises RadioLost."""
        self._seq += 1
        self._hand_over(Unicast(seq=self._seq, at_us=0, destination=destination, payload=payload))
        return self._seq

    def request_ftm(self, peer: int) -> int:
        """Range to a station; an `FtmResult` with the returned number will come. Raises RadioLost."""
        self._seq += 1
        self._hand_over(FtmRequest(seq=self._seq, at_us=0, peer=peer))
        return self._seq

    def receive(self, *, timeout_s: float) -> list[RxItem]:
        """Take what has arrived; wait for something until the time-out of wall time, then nothing comes."""
        items: list[RxItem] = []
        try:
            batch = self._batches.get(timeout=timeout_s)
            while True:
                self.now_us = batch.release_us
                items.extend(batch.items)
                batch = self._batches.get_nowait()
        except queue.Empty:
            return items

    def close(self) -> None:
        """Leave the channel; harmless when repeated."""
        self._transport.close()

    def _hand_over(self, *items: TxItem) -> None:
        batch = TxBatch(station=self.station, now_us=0, items=items)
        answer = self._asker.ask(encode(batch)).answer()
        if answer is None or decode(Ack, answer) is None:
            raise RadioLost(f"station {self.station}: the 802.11 emulator does not acknowledge")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _station(directory: Directory, name: str) -> int:
    if name not in directory.guests:
        known = ", ".join(directory.guests) or "none"
        raise RadioLost(f"there is no guest {name!r} on this channel; its guests: {known}")
    return directory.vehicles + directory.guests.index(name)

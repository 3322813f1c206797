"""A vehicle's way to the emulated channel, in lockstep: hand over transmissions, take what arrived.

Everything is sent one way, for what has to come is known: the vehicle tells the time master that it has
handed over a batch, and is told when one has been delivered to it (`netsim.wire.lockstep`). Stations
outside the lockstep have `netsim.transport.asynchronous_radio`. Here are the keys of the run's radio too.
"""

import logging
from collections import deque
from collections.abc import Iterator, Sequence
from typing import TypeVar

import msgspec

from netsim.transport.zenoh_session import Asker, Transport
from netsim.wire.messages import Ack, RxBatch, RxItem, TxBatch, TxItem, decode, encode

logger = logging.getLogger(__name__)
BatchT = TypeVar("BatchT", TxBatch, RxBatch)

ANSWER_LIMIT_S = 20.0
"""Wall time within which what is owed has to come; far beyond what a loaded machine needs."""
MOST_ITEMS = 24
"""In one batch on a direct connection, where they must fit `zenoh_session.LONGEST_DIRECT_BYTES`."""


def transmit_key(run_id: str) -> str:
    """TxBatch, sent by vehicles; or asked by other stations and answered with an Ack by the emulator."""
    return f"coflight/{run_id}/radio/tx"


def receive_key(run_id: str, station: int) -> str:
    """RxBatch, sent to a vehicle; or asked of another station, which answers with an Ack."""
    return f"coflight/{run_id}/radio/rx/{station}"


def directory_key(run_id: str) -> str:
    """Served by the emulator: DirectoryRequest -> Directory; ``*`` finds the run behind an endpoint."""
    return f"coflight/{run_id}/radio/directory"


class RadioLost(ConnectionError):
    """The emulator does not answer or deliver; the text is one line."""


class Deliveries:
    """What has come in for a station and waits for its time."""

    def __init__(self) -> None:
        self._batches: deque[RxBatch] = deque()
        self.put = self._batches.append
        """Add a batch; each is released later than the one before."""

    def take(self, now_us: int) -> list[RxItem]:
        """What may be seen at ``now_us``, in order of (time, source, sequence)."""
        items: list[RxItem] = []
        while self._batches and self._batches[0].release_us <= now_us:
            items.extend(self._batches.popleft().items)
        return items


def checked(batch: TxBatch) -> bytes:
    """Bytes of a batch that an emulator takes. Raises ValueError for what no station can send."""
    payload = encode(batch)
    if decode(TxBatch, payload) is None:  # the wire's own checks are made where it is decoded
        raise ValueError(f"station {batch.station}: the 802.11 emulator refuses what is sent")
    return payload


def hand_over(asker: Asker, batch: TxBatch) -> None:
    """Have the emulator take a batch and acknowledge it. Raises RadioLost."""
    answer = asker.ask(encode(batch)).answer()
    if answer is None or decode(Ack, answer) is None:
        raise RadioLost(f"station {batch.station}: the 802.11 emulator does not acknowledge")


class RadioClient:
    """A vehicle's radio, for one thread.

    Raises TransportError or RadioLost if the emulator cannot be reached. A station number that is in use is
    not refused: both hear.
    """

    def __init__(self, *, endpoint: str, run_id: str, station: int) -> None:
        self._station = station
        self.malformed = 0
        """Count of what came in on this station's key and was no delivery."""
        self._transport = Transport.connect(endpoint, direct=True)
        try:
            self._mailbox = self._transport.mailbox(receive_key(run_id, station))
            self._sender = self._transport.sender(transmit_key(run_id))
            # The declarations above travel ahead of this empty batch: once it is acknowledged, deliveries
            # find the way.
            asker = self._transport.asker(transmit_key(run_id), timeout_s=ANSWER_LIMIT_S)
            hand_over(asker, TxBatch(station=station, now_us=0, items=()))
        except BaseException:
            self._transport.close()
            raise

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions. Raises ValueError for what no station can send."""
        for batch in in_pieces(TxBatch(station=self._station, now_us=now_us, items=tuple(items))):
            self._sender.send(checked(batch))

    def receive(self, now_us: int) -> list[RxItem]:
        """What is released at ``now_us``, in order of (time, source, sequence), waiting for it if need be.

        To be called in the steps for which a delivery is announced, and in no other. Raises RadioLost.
        """
        items: list[RxItem] = []
        while True:
            payload = self._mailbox.take(ANSWER_LIMIT_S)
            if payload is None:
                raise RadioLost(f"station {self._station}: the 802.11 emulator does not deliver")
            batch = decode(RxBatch, payload)
            if batch is None or batch.station != self._station:
                self.malformed += 1
                logger.warning("dropped %d bytes that are no delivery", len(payload))
                continue
            items.extend(batch.items)
            if batch.release_us >= now_us and not batch.more:
                return items

    def close(self) -> None:
        """Leave the channel."""
        self._transport.close()


def in_pieces(batch: BatchT) -> Iterator[BatchT]:
    """A batch as one that a direct connection takes, or as several; almost always it is one."""
    if len(batch.items) <= MOST_ITEMS:
        yield batch
        return
    for first in range(0, len(batch.items), MOST_ITEMS):
        items, rest = batch.items[first : first + MOST_ITEMS], len(batch.items) - first - MOST_ITEMS
        yield msgspec.structs.replace(batch, items=items, more=rest > 0)

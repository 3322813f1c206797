"""A vehicle's way to the emulated channel: hand over transmissions, take what arrived, in lockstep.

With the keys of the run's radio. Programs outside the lockstep use `netsim.guest`.
"""

import logging
from collections import deque
from collections.abc import Callable, Sequence

from netsim.transport import Question, Transport
from netsim.wire.messages import Ack, RxBatch, RxItem, TxBatch, TxItem, decode, encode

logger = logging.getLogger(__name__)

ANSWER_LIMIT_S = 20.0
"""Wall time that the emulator has to acknowledge transmissions; far beyond what a loaded machine needs."""
DELIVERY_LIMIT_S = 0.25
"""Wall time that a station has to acknowledge a delivery before the time master is asked about it."""
ADVANCE_LIMIT_S = 20.0
"""Wall time that the emulator has for one interval; for stations it waits `DELIVERY_LIMIT_S` alone."""


BATCH_HANDED_OVER = 1 << 32
"""Bit of HIL_ACTUATOR_CONTROLS.flags, free in the standard: the vehicle gave its radio something to send."""


def transmit_key(run_id: str) -> str:
    """Served by the emulator: TxBatch -> Ack."""
    return f"coflight/{run_id}/radio/tx"


def receive_key(run_id: str, station: int) -> str:
    """Served by each station: RxBatch -> Ack."""
    return f"coflight/{run_id}/radio/rx/{station}"


def advance_key(run_id: str) -> str:
    """Served by the emulator: Advance -> Advanced."""
    return f"coflight/{run_id}/radio/advance"


def directory_key(run_id: str) -> str:
    """Served by the emulator: DirectoryRequest -> Directory; ``*`` finds the run behind an endpoint."""
    return f"coflight/{run_id}/radio/directory"


class RadioLost(ConnectionError):
    """The emulator does not acknowledge; the text is one line."""


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


class Inbox:
    """Takes a station's deliveries as they come in by Zenoh's threads, each once, and acknowledges them."""

    def __init__(self, station: int, put: Callable[[RxBatch], None]) -> None:
        self._station = station
        self._put = put
        self._newest_us = -1
        self.malformed = 0
        """Bytes on this station's key that were no delivery."""

    def take(self, question: Question) -> None:
        """Answer one question on the station's key."""
        batch = decode(RxBatch, question.payload)
        if batch is None or batch.station != self._station:
            self.malformed += 1
            logger.warning("dropped %d bytes that are no delivery", len(question.payload))
            return
        if batch.release_us > self._newest_us:  # else a repetition, for the first acknowledgement was late
            self._newest_us = batch.release_us
            self._put(batch)
        question.answer(_ACK)


class RadioClient:
    """One station's radio. Blocking, for one thread; deliveries come in by Zenoh's threads.

    Raises TransportError or RadioLost if the emulator cannot be reached. A station number that is in use is
    not refused: the deliveries go to the first.
    """

    def __init__(self, *, endpoint: str, run_id: str, station: int) -> None:
        self._station = station
        self._deliveries = Deliveries()
        self._inbox = Inbox(station, self._deliveries.put)
        self._transport = Transport.connect(endpoint)
        try:
            self._transport.serve(receive_key(run_id, station), self._inbox.take)
            self._asker = self._transport.asker(transmit_key(run_id), timeout_s=ANSWER_LIMIT_S)
            # The declaration above travels ahead of this empty batch: once it is acknowledged, deliveries
            # find the way.
            self.send(0, ())
        except BaseException:
            self._transport.close()
            raise

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions and wait until the emulator has them. Raises RadioLost."""
        batch = TxBatch(station=self._station, now_us=now_us, items=tuple(items))
        answer = self._asker.ask(encode(batch)).answer()
        if answer is None or decode(Ack, answer) is None:
            raise RadioLost(f"station {self._station}: the 802.11 emulator does not acknowledge")

    def receive(self, now_us: int) -> list[RxItem]:
        """What may be seen at ``now_us``, in order of (time, source, sequence)."""
        return self._deliveries.take(now_us)

    @property
    def malformed(self) -> int:
        """Count of what came in on this station's key and was no delivery."""
        return self._inbox.malformed

    def close(self) -> None:
        """Leave the channel."""
        self._transport.close()


_ACK = encode(Ack())

"""A radio whose host is in no lockstep: another program's, or that of an application beside a PX4.

What it sends goes on the air when it comes, and is acknowledged. What arrives is offered to it; nobody waits
until it is taken, and what is not is lost.
"""

import logging
from collections.abc import Callable, Sequence

from netsim.transport.lockstep_radio import ANSWER_LIMIT_S, hand_over, receive_key, transmit_key
from netsim.transport.zenoh_session import Question, Transport
from netsim.wire.messages import Ack, RxBatch, TxBatch, TxItem, decode, encode

logger = logging.getLogger(__name__)


class AsynchronousRadio:
    """One station's radio; ``put`` is given its deliveries as they come in, in a thread of Zenoh's.

    Raises RadioLost if the emulator does not answer. A station number that is in use is not refused: the
    deliveries go to the first.
    """

    def __init__(
        self, transport: Transport, *, run_id: str, station: int, put: Callable[[RxBatch], None]
    ) -> None:
        self._station = station
        self._put = put
        self._newest_us = -1
        self.malformed = 0
        """Bytes on this station's key that were no delivery."""
        transport.serve(receive_key(run_id, station), self._take)
        self._asker = transport.asker(transmit_key(run_id), timeout_s=ANSWER_LIMIT_S)
        self.hand_over(())  # acknowledged only after what was declared is known: deliveries find the way

    def hand_over(self, items: Sequence[TxItem], *, now_us: int = 0) -> None:
        """Have the emulator take transmissions and acknowledge them. Raises RadioLost."""
        hand_over(self._asker, TxBatch(station=self._station, now_us=now_us, items=tuple(items)))

    def _take(self, question: Question) -> None:
        batch = decode(RxBatch, question.payload)
        if batch is None or batch.station != self._station:
            self.malformed += 1
            logger.warning("dropped %d bytes that are no delivery", len(question.payload))
            return
        if batch.release_us > self._newest_us:  # deliveries rise; what does not is a stranger's
            self._newest_us = batch.release_us
            self._put(batch)
        question.answer(_ACK)


_ACK = encode(Ack())

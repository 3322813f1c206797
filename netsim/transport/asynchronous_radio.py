"""A radio whose host is not in lockstep: an external program.

Transmissions go on the air when they reach the emulator, and are acknowledged. The emulator does not wait for
received batches to be accepted; a batch that is not accepted is lost.
"""

from collections.abc import Callable, Sequence

from netsim.transport.lockstep_radio import ANSWER_LIMIT_S, guest_transmit_key, hand_over, receive_key
from netsim.transport.malformed import MalformedCount
from netsim.transport.zenoh_session import Question, Transport
from netsim.wire.messages import Ack, RxBatch, TxBatch, TxItem, decode, encode

_MOST_WAITING = 1_024
"""Deliveries that wait while the program's other threads hold the interpreter; the oldest ones are lost."""


class AsynchronousRadio:
    """One station's radio; ``put`` is called with each delivery, in a thread of its own.

    ``answer_limit_s`` is the wall time within which the emulator acknowledges transmissions.
    Raises RadioLost if the emulator does not respond. A station number in use is not rejected: the deliveries
    go to the first client.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        run_id: str,
        station: int,
        put: Callable[[RxBatch], None],
        answer_limit_s: float = ANSWER_LIMIT_S,
    ) -> None:
        self._station = station
        self._put = put
        self._newest_us = -1
        self._malformed = MalformedCount("delivery")
        transport.serve(receive_key(run_id, station), self._take, most_waiting=_MOST_WAITING)
        self._asker = transport.asker(guest_transmit_key(run_id, station), timeout_s=answer_limit_s)
        self.hand_over(())  # its acknowledgement shows that the key above is declared at the emulator

    @property
    def malformed(self) -> int:
        """Number of invalid messages on this station's key."""
        return self._malformed.count

    def hand_over(self, items: Sequence[TxItem], *, now_us: int = 0) -> None:
        """Send transmissions and wait for the emulator's acknowledgement. Raises RadioLost and RadioFull."""
        hand_over(self._asker, TxBatch(station=self._station, now_us=now_us, items=tuple(items)))

    def _take(self, question: Question) -> None:
        batch = decode(RxBatch, question.payload)
        if batch is None or batch.station != self._station:
            self._malformed.add(len(question.payload))
            return
        if batch.release_us > self._newest_us:  # release times rise; others are not of this run
            self._newest_us = batch.release_us
            self._put(batch)
        question.answer(_ACK)


_ACK = encode(Ack())

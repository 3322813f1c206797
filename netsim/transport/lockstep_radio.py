"""Radio client of a vehicle in lockstep, and the Zenoh keys of a run's radio.

Batches are sent one way without acknowledgement: the vehicle reports to the time master that it has sent a
batch, and the time master reports when one has been delivered (`netsim.wire.lockstep`). Stations outside the
lockstep use `netsim.transport.asynchronous_radio`.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import TypeVar

import msgspec

from netsim.transport.access_control import User
from netsim.transport.malformed import MalformedCount
from netsim.transport.zenoh_session import Asker, Transport
from netsim.wire.messages import (
    MOST_GUEST_ITEMS,
    Ack,
    RxBatch,
    RxItem,
    TxBatch,
    TxItem,
    decode,
    encode,
)

BatchT = TypeVar("BatchT", TxBatch, RxBatch)

ANSWER_LIMIT_S = 20.0
"""Time-out of expected messages, wall time; far above the need of a loaded machine."""
MOST_ITEMS = 24
"""Most items of a batch on a direct connection, limited by `zenoh_session.LONGEST_DIRECT_BYTES`."""


def vehicles_user(password: str) -> User:
    """Return the user of all vehicles."""
    return User("vehicles", password)


def all_keys(run_id: str) -> str:
    """Return the key expression of all keys of a run's radio."""
    return f"coflight/{run_id}/radio/**"


def transmit_key(run_id: str) -> str:
    """Return the key of vehicles' TxBatch: published, or queried with an empty one and an Ack as reply."""
    return f"coflight/{run_id}/radio/tx"


def guest_transmit_key(run_id: str, station: int | str) -> str:
    """Return the key of a guest's TxBatch: queried, with an Ack as reply; station ``*`` matches all."""
    return f"coflight/{run_id}/radio/tx/{station}"


def receive_key(run_id: str, station: int) -> str:
    """Return the key of RxBatch: published to vehicles, or queried at guests with an Ack as reply."""
    return f"coflight/{run_id}/radio/rx/{station}"


def packets_sent_key(run_id: str) -> str:
    """Return the key of SentPackets, published by the host of network interfaces."""
    return f"coflight/{run_id}/radio/packets/tx"


def packets_received_key(run_id: str) -> str:
    """Return the key of ReceivedPackets, published by the emulator."""
    return f"coflight/{run_id}/radio/packets/rx"


def directory_key(run_id: str) -> str:
    """Return the key of the emulator's directory: DirectoryRequest -> Directory."""
    return f"coflight/{run_id}/radio/directory"


class RadioLost(ConnectionError):
    """The emulator does not respond or deliver; the text is one line."""


class RadioFull(OSError):
    """The emulator has dropped a guest's transmissions, which were too many; the text is one line."""


class Deliveries:
    """Batches received for a station before their release time."""

    def __init__(self) -> None:
        self._batches: deque[RxBatch] = deque()
        self.put = self._batches.append
        """Add a batch; its release time is later than that of the previous one."""

    def take(self, now_us: int) -> list[RxItem]:
        """Return the items released by ``now_us``, in order of (time, source, sequence)."""
        items: list[RxItem] = []
        while self._batches and self._batches[0].release_us <= now_us:
            items.extend(self._batches.popleft().items)
        return items


def checked(batch: TxBatch) -> bytes:
    """Return the bytes of a batch. Raises ValueError if an emulator would reject it."""
    payload = encode(batch)
    if decode(TxBatch, payload) is None:  # ranges are checked by the decoder
        raise ValueError(f"station {batch.station}: the 802.11 emulator rejects the transmission")
    return payload


def hand_over(asker: Asker, batch: TxBatch) -> None:
    """Send a batch to the emulator and wait for its acknowledgement. Raises RadioLost and RadioFull."""
    answer = asker.ask(encode(batch)).answer()
    ack = None if answer is None else decode(Ack, answer)
    if ack is None:
        raise RadioLost(f"station {batch.station}: the 802.11 emulator does not acknowledge")
    if ack.full:
        raise RadioFull(
            f"station {batch.station}: the 802.11 emulator has dropped {len(batch.items)} transmissions: it "
            f"takes at most {MOST_GUEST_ITEMS} of a guest until simulated time goes on"
        )


class RadioClient:
    """A vehicle's radio, for one thread.

    Raises TransportError or RadioLost if the emulator cannot be reached. A station number in use is not
    rejected: both clients receive the deliveries.
    """

    def __init__(self, *, endpoint: str, password: str, run_id: str, station: int) -> None:
        self._station = station
        self._malformed = MalformedCount("delivery")
        self._transport = Transport.connect(endpoint, vehicles_user(password), direct=True)
        try:
            self._mailbox = self._transport.mailbox(receive_key(run_id, station))
            self._sender = self._transport.sender(transmit_key(run_id))
            # The acknowledgement of this empty batch shows that the declarations above have arrived.
            asker = self._transport.asker(transmit_key(run_id), timeout_s=ANSWER_LIMIT_S)
            hand_over(asker, TxBatch(station=station, now_us=0, items=()))
        except BaseException:
            self._transport.close()
            raise

    @property
    def malformed(self) -> int:
        """Number of invalid messages on this station's key."""
        return self._malformed.count

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Send transmissions to the emulator. Raises ValueError for an invalid item."""
        for batch in in_pieces(TxBatch(station=self._station, now_us=now_us, items=tuple(items))):
            self._sender.send(checked(batch))

    def receive(self, now_us: int) -> list[RxItem]:
        """Wait for the items released at ``now_us`` and return them, in order of (time, source, sequence).

        To be called only in steps for which a delivery is announced. Raises RadioLost.
        """
        items: list[RxItem] = []
        while True:
            payload = self._mailbox.take(ANSWER_LIMIT_S)
            if payload is None:
                raise RadioLost(f"station {self._station}: the 802.11 emulator does not deliver")
            batch = decode(RxBatch, payload)
            if batch is None or batch.station != self._station:
                self._malformed.add(len(payload))
                continue
            items.extend(batch.items)
            if batch.release_us >= now_us and not batch.more:
                return items

    def close(self) -> None:
        """Leave the channel."""
        self._transport.close()


def in_pieces(batch: BatchT) -> Iterator[BatchT]:
    """Split a batch into batches of at most `MOST_ITEMS` items; usually it is one."""
    if len(batch.items) <= MOST_ITEMS:
        yield batch
        return
    for first in range(0, len(batch.items), MOST_ITEMS):
        items, rest = batch.items[first : first + MOST_ITEMS], len(batch.items) - first - MOST_ITEMS
        yield msgspec.structs.replace(batch, items=items, more=rest > 0)

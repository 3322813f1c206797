"""Exchange of packets with the host of network interfaces while an interval is simulated.

With a pace, simulated time follows wall time within the interval: the channel waits for the time of its next
event, or for a packet, and publishes what is received at once. During such a wait the thread in which a
packet arrives simulates up to the present and publishes, since waking the other thread takes longer. A packet
is placed at the simulated time at which it was read from its interface; an interval that is late is simulated
without waiting, with the packets at their places as far as the channel has not passed them. Without a pace,
packets are placed at the beginning of an interval, and receptions are published at its end.
"""

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from netsim.emulator.interface import NetworkEmulator
from netsim.emulator.packets import PacketReception
from netsim.transport.malformed import MalformedCount
from netsim.transport.packet_pace import Lateness, Pace, pace_of
from netsim.wire.lockstep import Advance
from netsim.wire.messages import RxBatch, Station
from netsim.wire.packets import (
    MAX_PACKET_BYTES,
    ReceivedPacket,
    ReceivedPackets,
    SentPacket,
    decode_sent,
    encode_packets,
)

logger = logging.getLogger(__name__)
MOST_WAITING_PACKETS = 1_024
"""Most packets of a station that wait to leave its radio; further ones are dropped and counted."""
MOST_WAITING_MESSAGES = 4_096
MOST_WAITING_BYTES = 1 << 28
"""Most messages that wait for the emulator, beside one for each packet in the interfaces' windows, and their
bytes; further ones are dropped and counted. Their packets would never leave the windows."""
LONGEST_SENT_BYTES = 64 * (MAX_PACKET_BYTES + 64)
"""Longest accepted message: 64 packets of greatest length."""
LONGEST_RECEIVED_BYTES = 48_000
"""Longest published message, below `netsim.transport.zenoh_session.LONGEST_DIRECT_BYTES`."""
LEAST_STEP_NS = 200_000
"""Least simulated time between two waits, which batches the events of a frame exchange."""
_OVERHEAD_BYTES, _STATION_BYTES = 40, 3
"""Most bytes of a received packet's fields beside its payload, and of each of its receivers."""
_NS_PER_S = 1e9


class Inbox(Protocol):
    """Messages of the host of network interfaces: see `netsim.transport.packet_inbox`."""

    dropped: int
    """Number of messages that were dropped as too many waited."""

    def put(self, payload: bytes, /) -> None:
        """Add a message."""

    def take(self) -> bytes | None:
        """Return the next message at once; None without any."""

    def wait(self, wall_limit_s: float, /) -> None:
        """Wait for `wake` or for ``wall_limit_s``."""

    def wake(self) -> None:
        """End the present or the next wait."""


class PacketExchange:
    """Simulates intervals of an emulator with the packets that arrive meanwhile.

    ``vehicles`` is the number of stations with interfaces; ``publish`` sends a message; ``now_ns`` is the
    machine's monotonic clock. ``on_packets`` is called for every message with packets, and ``on_malformed``
    for every invalid message.

    One thread calls `advance`, another one `receive`; one of them at a time uses the emulator and the
    functions, also ``publish``.
    """

    def __init__(
        self,
        emulator: NetworkEmulator,
        inbox: Inbox,
        *,
        vehicles: int,
        publish: Callable[[bytes], None],
        now_ns: Callable[[], int],
        on_packets: Callable[[], None],
        on_malformed: Callable[[], None],
    ) -> None:
        self._emulator = emulator
        self._inbox = inbox
        self._vehicles = vehicles
        self._publish = publish
        self._now_ns = now_ns
        self._on_packets = on_packets
        self._on_malformed = on_malformed
        self.malformed = MalformedCount("message of the network interfaces")
        self._in_use = threading.Lock()
        """Locked by the thread that uses the emulator and the fields below."""
        self._awaited: Pace | None = None
        """Pace of the interval while `advance` waits in it."""
        self._error: Exception | None = None
        """Error of the emulator in `receive`, to be raised by `advance`."""
        self._reached_ns = 0
        """Time up to which the channel has been simulated."""
        self._unplaced: deque[tuple[int, SentPacket]] = deque()
        """Accepted packets that the channel has not received, with the wall times of their reading."""
        self._waiting: Counter[Station] = Counter()
        """Packets by sender that have not left its radio."""
        self._refused: Counter[Station] = Counter()
        """Dropped packets by sender, to be reported as ended."""
        self._sent = self._dropped = 0
        self._transmissions, self._receptions = Lateness(), Lateness()

    @property
    def counters(self) -> dict[str, Any]:
        """Counters since the start of the run.

        ``sent`` packets have been accepted; ``dropped`` ones exceeded `MOST_WAITING_PACKETS`.
        ``transmissions`` are late by the wall time by which the channel had passed the time of their reading,
        ``receptions`` by that from the end of their frame until they are published. Neither is counted
        without a pace.
        """
        return {
            "sent": self._sent,
            "dropped": self._dropped,
            "dropped_messages": self._inbox.dropped,
            "transmissions": self._transmissions.counters,
            "receptions": self._receptions.counters,
        }

    def advance(self, request: Advance) -> dict[Station, RxBatch]:
        """Simulate an interval as `NetworkEmulator.advance`, and exchange packets.

        Returns when the interval has been simulated, with a pace not before it is due. Raises ValueError for
        an invalid request.
        """
        emulator, to_ns, pace = self._emulator, 1_000 * request.to_us, pace_of(request)
        with self._in_use:
            emulator.begin(request)
            self._accept_all()
            if pace is None:
                self._place_all()
            else:
                self._follow(pace)
            emulator.run_until(to_ns)
            self._reached_ns = to_ns
            deliveries = emulator.end(request)
            self._publish_receptions(pace)
        return deliveries

    def receive(self, payload: bytes) -> None:
        """Add a message; exchange its packets at once if `advance` waits in a paced interval.

        Does not wait for the other thread, which otherwise takes the message before it waits again.
        """
        self._inbox.put(payload)
        if self._in_use.acquire(blocking=False):
            try:
                if self._awaited is not None:
                    self._exchange(self._awaited)
            except Exception as error:  # noqa: BLE001  # of a user's emulator or model: for the other thread
                self._error = error
            finally:
                self._in_use.release()
        self._inbox.wake()  # the next event may be earlier

    def _follow(self, pace: Pace) -> None:
        """Simulate up to the end of the interval as it becomes due."""
        to_ns = pace.to_ns
        self._place_due(pace)
        while self._reached_ns < to_ns:
            next_ns = max(self._emulator.next_event_ns, self._reached_ns + LEAST_STEP_NS)
            wait_ns = pace.wall_ns(min(next_ns, to_ns)) - self._now_ns()
            if wait_ns > 0:
                self._wait(pace, wait_ns / _NS_PER_S)
            self._exchange(pace)

    def _wait(self, pace: Pace, wall_limit_s: float) -> None:
        """Wait for packets and leave the emulator to `receive` meanwhile."""
        self._awaited = pace
        self._in_use.release()
        try:
            self._inbox.wait(wall_limit_s)
        finally:
            self._in_use.acquire()
            self._awaited = None
        if self._error is not None:
            raise self._error

    def _exchange(self, pace: Pace) -> None:
        """Place the packets that have arrived, simulate up to the present, and publish what is received."""
        self._accept_all()
        self._place_due(pace)
        present_ns = min(max(pace.simulated_ns(self._now_ns()), self._reached_ns), pace.to_ns)
        self._emulator.run_until(present_ns)
        self._reached_ns = present_ns
        if present_ns < pace.to_ns:
            self._publish_receptions(pace)

    # --- packets sent

    def _accept_all(self) -> None:
        """Accept the packets of messages that have arrived."""
        for _ in range(MOST_WAITING_MESSAGES):  # a sender without pauses must not stop the channel
            payload = self._inbox.take()
            if payload is None:
                return
            self._accept(payload)

    def _accept(self, payload: bytes) -> None:
        message = decode_sent(payload) if len(payload) <= LONGEST_SENT_BYTES else None
        if message is None or any(packet.station >= self._vehicles for packet in message.packets):
            self.malformed.add(len(payload))
            self._on_malformed()
            return
        if message.packets:
            self._on_packets()
        present_ns = self._now_ns()
        for packet in message.packets:
            if self._waiting[packet.station] >= MOST_WAITING_PACKETS:
                self._refuse(packet.station)
                continue
            self._sent += 1
            self._waiting[packet.station] += 1
            self._unplaced.append((min(packet.read_ns, present_ns), packet))

    def _refuse(self, station: Station) -> None:
        """Count a packet that is dropped; the first one is logged."""
        if not self._dropped:
            logger.warning(
                "uav-%d: more than %d packets of its network interface wait for its radio: further ones are "
                "dropped and counted", station, MOST_WAITING_PACKETS,
            )  # fmt: skip
        self._dropped += 1
        self._refused[station] += 1

    def _place_all(self) -> None:
        """Place all packets at the present time of the channel."""
        while self._unplaced:
            _, packet = self._unplaced.popleft()
            self._emulator.submit_packet(packet, self._reached_ns)

    def _place_due(self, pace: Pace) -> None:
        """Place the packets that were read before the end of the interval, and measure their lateness."""
        while self._unplaced:
            read_ns, packet = self._unplaced[0]
            exact_ns = pace.simulated_ns(read_ns)
            if exact_ns > pace.to_ns:
                return
            self._unplaced.popleft()
            self._emulator.submit_packet(packet, max(exact_ns, self._reached_ns))
            self._transmissions.add((self._reached_ns - exact_ns) / pace.speed)

    # --- packets received

    def _publish_receptions(self, pace: Pace | None) -> None:
        """Publish the receptions and the ended packets since the last call, if there are any."""
        ended = Counter(self._emulator.take_ended())
        self._waiting -= ended
        ended += self._refused
        self._refused.clear()
        receptions = self._emulator.take_packets()
        pieces = list(_in_pieces([_received(each, pace) for each in receptions]))
        if not pieces:
            if not ended:
                return
            pieces = [()]
        *first, last = pieces
        for piece in first:
            self._publish(encode_packets(ReceivedPackets(packets=piece)))
        self._publish(encode_packets(ReceivedPackets(packets=last, ended=tuple(sorted(ended.items())))))
        if pace is not None:
            present_ns = self._now_ns()
            for reception in receptions:
                self._receptions.add(present_ns - pace.wall_ns(reception.end_ns))


def _received(reception: PacketReception, pace: Pace | None) -> ReceivedPacket:
    return ReceivedPacket(
        stations=reception.stations,
        source=reception.source,
        destination=reception.destination,
        ether_type=reception.ether_type,
        due_ns=0 if pace is None else max(0, pace.wall_ns(reception.end_ns)),
        payload=reception.payload,
    )


def _in_pieces(packets: list[ReceivedPacket]) -> Iterator[tuple[ReceivedPacket, ...]]:
    """Split packets into messages of at most `LONGEST_RECEIVED_BYTES`, in their order."""
    piece: list[ReceivedPacket] = []
    size = 0
    for packet in packets:
        own = _OVERHEAD_BYTES + len(packet.payload) + _STATION_BYTES * len(packet.stations)
        if piece and size + own > LONGEST_RECEIVED_BYTES:
            yield tuple(piece)
            piece, size = [], 0
        piece.append(packet)
        size += own
    if piece:
        yield tuple(piece)

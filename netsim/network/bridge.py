"""Bridge between interfaces and emulator: frames become `SentPacket`, `ReceivedPacket` become frames; pure.

Each station has at most ``window_packets`` packets in the emulator, which reports those that have left the
radios' queues. Beyond that its frames are to be left in the kernel (`Bridge.is_open`), whose buffer has a
limit.
"""

from collections.abc import Collection, Iterable, Iterator

from netsim.network.ethernet import access_category, build, parse
from netsim.transport.packet_pace import Lateness
from netsim.wire.addresses import is_group, mac_address, station_of
from netsim.wire.messages import Station
from netsim.wire.packets import MAX_PACKET_BYTES, ReceivedPacket, ReceivedPackets, SentPacket

WINDOW_PACKETS = 64
"""Default of ``window_packets``, the length of a radio's queue."""


class Bridge:
    """The packets of the stations that have interfaces. Raises ValueError for a window below 1."""

    def __init__(self, stations: Iterable[Station], *, window_packets: int = WINDOW_PACKETS) -> None:
        if window_packets < 1:
            raise ValueError(f"window_packets must be at least 1, not {window_packets}")
        self._window_packets = window_packets
        self._outstanding = dict.fromkeys(stations, 0)
        self._addresses = {station: mac_address(station) for station in self._outstanding}
        self.lateness = Lateness()
        self._sent = self._received = self._frames = 0
        self._dropped = dict.fromkeys(("not ethernet ii", "length", "source", "destination"), 0)

    def is_open(self, station: Station) -> bool:
        """Whether the window of a station has room, so that its interface is to be read."""
        return self._outstanding[station] < self._window_packets

    def accept(self, station: Station, frame: bytes, read_ns: int) -> SentPacket | None:
        """Return the packet of a frame that a station's interface has sent; None if it is dropped.

        Dropped are frames that are no Ethernet II frames or too long, and those whose source is not the
        interface or whose destination is not an address of a station or group.
        """
        parts = parse(frame)
        if parts is None:
            return self._dropped_for("not ethernet ii")
        destination, source, ether_type, payload = parts
        if len(payload) > MAX_PACKET_BYTES:
            return self._dropped_for("length")
        if source != self._addresses[station]:
            return self._dropped_for("source")
        if not is_group(destination) and station_of(destination) is None:
            return self._dropped_for("destination")
        self._sent += 1
        self._outstanding[station] += 1
        return SentPacket(
            station=station, destination=destination, ether_type=ether_type,
            category=access_category(ether_type, payload), read_ns=read_ns, payload=payload,
        )  # fmt: skip

    def receive(self, message: ReceivedPackets, now_ns: int) -> Iterator[tuple[Station, bytes]]:
        """Yield the frames of received packets, with the station whose interface receives each.

        Receivers without an interface are skipped. ``now_ns`` is the present wall time, of the clock of
        `ReceivedPacket.due_ns`.
        """
        for packet in message.packets:
            self._received += 1
            if packet.due_ns:
                self.lateness.add(now_ns - packet.due_ns)
            frame = _frame(packet)
            for station in packet.stations:
                if station in self._outstanding:
                    self._frames += 1
                    yield station, frame

    def end(self, ended: Collection[tuple[Station, int]]) -> list[Station]:
        """Take packets out of the windows; return the stations whose windows have room again by this.

        Numbers are limited to the packets that are outstanding.
        """
        opened = []
        for station, number in ended:
            outstanding = self._outstanding.get(station)
            if outstanding is None or number <= 0:
                continue
            was_open = self.is_open(station)
            self._outstanding[station] = max(outstanding - number, 0)
            if not was_open and self.is_open(station):
                opened.append(station)
        return opened

    @property
    def counters(self) -> dict[str, object]:
        """Return the numbers of packets and frames of the run, and its lateness."""
        return {
            "sent_packets": self._sent,
            "received_packets": self._received,
            "delivered_frames": self._frames,
            "outstanding_packets": sum(self._outstanding.values()),
            "dropped_frames": dict(self._dropped),
            "lateness": self.lateness.counters,
        }

    def _dropped_for(self, reason: str) -> SentPacket | None:
        self._dropped[reason] += 1
        return None


def _frame(packet: ReceivedPacket) -> bytes:
    return build(packet.destination, mac_address(packet.source), packet.ether_type, packet.payload)

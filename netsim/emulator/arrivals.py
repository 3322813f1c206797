"""Items that have reached the stations' hosts: datagrams, reports of unicasts and results of ranging."""

from collections.abc import Callable
from math import log10
from operator import itemgetter

import msgspec

from netsim.emulator.packets import Packets
from netsim.emulator.records import Tally
from netsim.ftm.initiator import Ranging
from netsim.mac.jobs import DatagramReception
from netsim.model.random_streams import FloatStream, Model, RandomStreams
from netsim.phy.frames import Datagram, Packet
from netsim.wire.messages import Delivery, FtmResult, RxItem, Sent, Survey

_Received = tuple[int, int, int, RxItem]
"""An item that has reached a station: time in ns, source, sequence number, item."""
_ORDER = itemgetter(0, 1, 2)


class Arrivals:
    """Received items by station, until the end of the interval.

    ``vehicles`` of the ``stations`` also receive surveys; ``silent`` stations get no results.
    ``drop_fraction`` is the share of items that hosts lose; ``tally`` counts them and the ranging sessions.
    ``packets`` takes the packets among the received frames.
    """

    def __init__(
        self,
        *,
        stations: int,
        vehicles: int,
        drop_fraction: float,
        streams: RandomStreams,
        tally: Tally,
        silent: set[int],
        packets: Packets,
    ) -> None:
        self._vehicles = vehicles
        self._drop_fraction = drop_fraction
        self._losses: list[FloatStream] = []
        """Draws by station; empty if ``drop_fraction`` is 0."""
        if drop_fraction > 0.0:
            self._losses = [streams.uniforms(Model.HOST_LOSS, i) for i in range(stations)]
        self._tally = tally
        self._silent = silent
        self._packets = packets
        self._received: list[list[_Received]] = [[] for _ in range(stations)]
        """Items by receiving station."""

    def add_datagram(self, received: DatagramReception) -> None:
        """Add a datagram to the deliveries of its receivers, except where the host loses it.

        A packet is passed to `Packets` instead.
        """
        source, seq, datagram = received.source, received.seq, received.body
        if not isinstance(datagram, Datagram):
            if not isinstance(datagram, Packet):
                raise TypeError("the body of a data frame must be a Datagram or a Packet")
            self._packets.add(datagram, received, [self._host_loses(each) for each in received.stations])
            return
        for station, end_ns, power_mw in zip(
            received.stations, received.ends_ns, received.powers_mw, strict=True
        ):
            if self._host_loses(station):
                self._tally.lost_by_hosts += 1
                continue
            rssi_dbm = 10.0 * log10(power_mw)
            item = Delivery(
                source=source, seq=seq, received_ns=end_ns, rssi_dbm=rssi_dbm, payload=datagram.payload,
                port=datagram.port,
            )  # fmt: skip
            self._received[station].append((end_ns, source, seq, item))

    def add_item(self, station: int, at_ns: int, source: int, seq: int, item: RxItem) -> None:
        """Add an item that has reached a station."""
        self._received[station].append((at_ns, source, seq, item))

    def add_report(self, station: int, sent: Sent) -> None:
        """Add the report of a station's unicast datagram."""
        if station not in self._silent:
            self._received[station].append((sent.ended_ns, sent.destination, sent.seq, sent))

    def add_ranging(self, ranging: Ranging) -> None:
        """Add the result of a ranging session to its initiator's items, without measured values if lost."""
        if ranging.status == "ok" and self._host_loses(ranging.initiator):
            ranging = msgspec.structs.replace(
                ranging,
                status="lost",
                measured_ns=ranging.ended_ns,
                distance_m=0.0,
                distance_std_m=0.0,
                rssi_dbm=0.0,
                round_trips=0,
            )
        self._tally.count_session(ranging)
        if ranging.initiator in self._silent:
            return
        result = FtmResult(**{name: getattr(ranging, name) for name in FtmResult.__struct_fields__})
        self._received[ranging.initiator].append((ranging.ended_ns, ranging.peer, ranging.seq, result))

    def take(self, ended_ns: int, surveyed_ns: Callable[[], list[int]]) -> dict[int, list[RxItem]]:
        """Return and clear the items of stations that received any, each list in order.

        The order is (time, source, sequence number); a vehicle's list ends with a `Survey` at ``ended_ns`` of
        the time that ``surveyed_ns`` returns for each station.
        """
        if not any(self._received):
            return {}
        busy_ns = surveyed_ns()
        arrived: dict[int, list[RxItem]] = {}
        for station, received in enumerate(self._received):
            if received:
                received.sort(key=_ORDER)
                arrived[station] = items = [entry[-1] for entry in received]
                received.clear()
                if station < self._vehicles:
                    items.append(Survey(ended_ns=ended_ns, busy_ns=busy_ns[station]))
        return arrived

    def _host_loses(self, station: int) -> bool:
        return bool(self._losses) and self._losses[station].draw() < self._drop_fraction

"""The serial modems of a run: items of the stations' hosts in, items for them out.

`netsim.serial_radio` has the model; this module translates between it and `netsim.wire`. Pair i is that of
vehicle i and the ground station.
"""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from netsim.model.config import RadioConfig
from netsim.serial_radio.config import SerialPairsConfig
from netsim.serial_radio.gains import PathGains
from netsim.serial_radio.links import SerialLinks
from netsim.serial_radio.packets import whole_frames
from netsim.wire.messages import RxItem, SerialBytes, SerialReceived, SerialReport

Doubles = NDArray[np.float64]
_US = 1_000


class ReceivedItem(NamedTuple):
    """An item for a station's host."""

    station: int
    at_ns: int
    peer: int
    seq: int
    item: RxItem


class SerialModems:
    """A pair of modems for each of the ``vehicles`` among the ``stations``.

    Raises ValueError for settings with which no packet fits into a window, and ExtensionError as `PathGains`.
    """

    def __init__(
        self,
        config: SerialPairsConfig,
        *,
        radio: RadioConfig,
        vehicles: int,
        stations: int,
        seed: np.random.SeedSequence,
    ) -> None:
        self._vehicles, self._ground = vehicles, config.ground_station
        own = {each.station: each.antenna_gain_dbi for each in radio.stations}
        gain_dbi = own.get(self._ground)
        self._gains = PathGains(
            radio,
            config.settings,
            stations,
            seed,
            own_gain_dbi=None if gain_dbi is None else {self._ground: gain_dbi},
        )
        pairs = [(vehicle, self._ground) for vehicle in range(vehicles)]
        self._links = SerialLinks(config.settings, pairs, self._gains, seed)
        self._sequences = [0] * (2 * vehicles)
        """By modem: number of its next item."""

    def has_modem(self, station: int, peer: int) -> bool:
        """Whether a station has a modem whose pair is at ``peer``."""
        vehicle, ground = min(station, peer), max(station, peer)
        return vehicle < self._vehicles and ground == self._ground

    def set_motion(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles, q_ned_frd: Doubles) -> None:
        """Set the stations' positions (n, 3) at ``at_ns``, velocities (n, 3) and attitudes (n, 4), wxyz."""
        self._gains.set_motion(at_ns, pos_ned_m, vel_ned_m_s, q_ned_frd)

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links, dB."""
        self._gains.set_extra_attenuation_db(value)

    def submit(self, station: int, items: Iterable[SerialBytes]) -> None:
        """Write a station's bytes to its modems, whole frames as far as the hosts' buffers have space."""
        for item in items:
            end = 2 * station if station != self._ground else 2 * item.peer + 1
            for piece in whole_frames(item.payload):
                self._links.submit(end, piece, _US * item.at_us)

    def run_until(self, time_ns: int) -> None:
        """Simulate up to and including ``time_ns``."""
        self._links.run_until(time_ns)

    @property
    def next_event_ns(self) -> int:
        """Time before which nothing happens without further submissions."""
        return self._links.next_event_ns

    def take(self) -> Iterator[ReceivedItem]:
        """Yield what has arrived at the hosts since the last call."""
        for delivery in self._links.take():
            station, peer, seq = self._number(delivery.end)
            item = SerialReceived(peer=peer, seq=seq, received_ns=delivery.at_ns, payload=delivery.data)
            yield ReceivedItem(station, delivery.at_ns, peer, seq, item)
        for report in self._links.take_reports():
            station, peer, seq = self._number(report.end)
            fields = report.status._asdict()
            yield ReceivedItem(
                station, report.at_ns, peer, seq,
                SerialReport(peer=peer, seq=seq, received_ns=report.at_ns, **fields),
            )  # fmt: skip

    def _number(self, end: int) -> tuple[int, int, int]:
        """Return the station of a modem, that of the other one, and the number of its next item."""
        seq = self._sequences[end]
        self._sequences[end] += 1
        vehicle = end // 2
        return (self._ground, vehicle, seq) if end % 2 else (vehicle, self._ground, seq)

    @property
    def counters(self) -> dict[str, Any]:
        """Sums of `netsim.serial_radio.links.SerialCounters` over the modems of each side."""
        return {name: self._sums(side) for side, name in enumerate(("vehicles", "ground_station"))}

    def _sums(self, side: int) -> dict[str, int]:
        sums: dict[str, int] = {}
        for vehicle in range(self._vehicles):
            for name, count in structs.asdict(self._links.counters(2 * vehicle + side)).items():
                sums[name] = sums.get(name, 0) + count
        return sums

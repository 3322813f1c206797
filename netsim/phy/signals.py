"""What is on the air, and what a station's receiver knows of it."""

from typing import NamedTuple, Protocol

import numpy as np

from netsim.frames import Frame
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import LinkRow
from netsim.phy.sensing import (
    BUSY_FROM,
    BUSY_UNTIL,
    ENDED_BUSY,
    IDLE_BEFORE,
    LOCK,
    SENDING_FROM,
    SENDING_UNTIL,
    SENSED_AT_START,
    SENT_ALONE,
    UNLOCKED,
    Integers,
)
from netsim.streams import Uniforms


class Listener(Protocol):
    """What a receiver tells its MAC: what is for it, and what it heeds (`netsim.phy.sensing`)."""

    def on_busy(self, from_ns: int) -> None:
        """Note that the medium is busy from then on; that may lie ahead by the propagation delay."""

    def on_received(self, transmission: "Transmission", power_mw: float, end_ns: int) -> None:
        """Take a frame that was received whole, for whomever it is."""

    def on_error(self, end_ns: int) -> None:
        """Note that a frame which the receiver was locked on to ended in errors."""

    def on_sent(self, transmission: "Transmission") -> None:
        """Note that the own transmission has ended."""

    def on_air_changed(self) -> None:
        """Note that a transmission has ended at all receivers, and what was made of it has been told."""

    def on_unused(self) -> None:
        """Note that a reservation has fallen, for nothing was heard after the frame that made it."""


class Others(NamedTuple):
    """Signals beside one, as the passes of `netsim.phy.sensing` take them."""

    spans: Integers
    """(k, 3): start and end at the transmitter, nanoseconds, and the source."""
    powers_mw: Doubles
    """(k, stations)"""
    delays_ns: Integers
    """(k, stations)"""


def none_of(stations: int) -> Others:
    """Say that nothing else is on the air."""
    return Others(np.empty((0, 3), np.int64), np.empty((0, stations)), np.empty((0, stations), np.int64))


class Signal:
    """Energy on the air: an interferer's burst, whose ``source`` is negative, or a frame."""

    __slots__ = (
        "_others", "delays_ns", "end_ns", "longest_delay_ns", "overlaps", "powers_mw", "source", "start_ns",
    )  # fmt: skip

    def __init__(self, source: int, start_ns: int, end_ns: int, row: LinkRow, powers_mw: Doubles) -> None:
        self.source = source
        self.start_ns = start_ns
        self.end_ns = end_ns
        self.powers_mw = powers_mw
        """By station, as are the delays."""
        self.delays_ns = row.delays_ns
        self.longest_delay_ns = row.longest_delay_ns
        self.overlaps: list[Signal] = []
        """Those that were on the air at some time with it; of a burst, those that began before."""
        self._others: Others | None = None

    def others(self) -> Others:
        """Give the signals that overlap it, of which there is at least one."""
        others, overlaps = self._others, self.overlaps
        if others is None or len(others.spans) != len(overlaps):
            others = self._others = Others(
                np.array([(other.start_ns, other.end_ns, other.source) for other in overlaps]),
                np.array([other.powers_mw for other in overlaps]),
                np.array([other.delays_ns for other in overlaps]),
            )
        return others

    def forget_others(self) -> None:
        """Let go of the signals that overlap it."""
        self.overlaps.clear()
        self._others = None

    def power_mw(self, station: int) -> float:
        """Power at one station."""
        return self.powers_mw.item(station)

    def delay_ns(self, station: int) -> int:
        """Time that it takes to one station."""
        return self.delays_ns.item(station)


class Transmission(Signal):
    """A frame on the air, and what became of it."""

    __slots__ = ("collided", "delivered", "frame", "lost_to_noise", "number")

    def __init__(
        self, frame: Frame, start_ns: int, row: LinkRow, powers_mw: Doubles, number: int = 0
    ) -> None:
        super().__init__(frame.source, start_ns, start_ns + frame.duration_ns, row, powers_mw)
        self.frame = frame
        self.number = number
        """Which of the medium's it is."""
        self.delivered: list[int] = []
        self.collided: list[int] = []
        self.lost_to_noise: list[int] = []


class Receiver:
    """One station's receiver: its row of what is sensed, and how long it has sensed the medium busy."""

    __slots__ = ("index", "listener", "row", "uniforms")

    def __init__(self, index: int, state: Integers, uniforms: Uniforms) -> None:
        """``state`` is that of all stations, see `netsim.phy.sensing`."""
        self.index = index
        self.uniforms = uniforms
        self.listener: Listener
        self.row = memoryview(state[index])  # of which single numbers are quicker to be had than of an array
        """Columns of `netsim.phy.sensing`."""

    def send(self, from_ns: int, until_ns: int) -> None:
        """Send from now on: what is being received is given up."""
        row = self.row
        row[LOCK] = UNLOCKED
        row[SENDING_FROM] = from_ns
        row[SENDING_UNTIL] = until_ns
        row[SENSED_AT_START] = self._sensed_ns(from_ns)

    def sent(self) -> None:
        """Note that the own transmission is over, after it has ended everywhere."""
        row = self.row
        row[SENT_ALONE] += self._sending_alone_ns(row[SENDING_UNTIL])
        row[SENDING_FROM] = row[SENDING_UNTIL]

    def surveyed_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns``, which is now, for which the medium was sensed busy or the station sent."""
        return self._sensed_ns(at_ns) + self.row[SENT_ALONE] + self._sending_alone_ns(at_ns)

    def _sensed_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns`` for which the medium was sensed busy; the last but one period may be on."""
        row = self.row
        if at_ns >= row[BUSY_UNTIL]:
            return row[ENDED_BUSY] + row[BUSY_UNTIL] - row[BUSY_FROM]
        if at_ns >= row[BUSY_FROM]:
            return row[ENDED_BUSY] + at_ns - row[BUSY_FROM]
        return row[ENDED_BUSY] - max(0, row[IDLE_BEFORE] - at_ns)

    def _sending_alone_ns(self, at_ns: int) -> int:
        """Time up to ``at_ns`` of the own transmission under way in which nothing was sensed."""
        row = self.row
        until_ns, from_ns = row[SENDING_UNTIL], row[SENDING_FROM]
        if at_ns < until_ns:
            until_ns = at_ns
        if until_ns <= from_ns:
            return 0
        return until_ns - from_ns - (self._sensed_ns(until_ns) - row[SENSED_AT_START])

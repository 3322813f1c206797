"""Datagrams of a link as bytes of the vehicle's serial modem. No I/O.

The other modem of the pair is at the ground station. Nothing is acknowledged. The modem reports RADIO_STATUS
after each heartbeat that it has sent.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.radio_carrier import FIRST_SEQUENCE
from netsim.wire.messages import RxItem, SerialBytes, SerialReceived, SerialReport, TxItem

MODEM_SYSTEM, MODEM_COMPONENT = ord("3"), ord("D")
"""Source of the modem's RADIO_STATUS, as the firmware SiK sets it (Firmware/radio/mavlink.c)."""
_MOST_WAITING = 1_024
"""Received pieces that wait for the link; the oldest are dropped."""


@dataclass(slots=True)
class SerialCounts:
    """Counts of what passed between a host and its modem."""

    sent_bytes: int = 0
    """Written to the modem."""
    received_bytes: int = 0
    """Of the other end."""
    radio_status: int = 0
    """Reports of the modem."""


def radio_status(report: SerialReport) -> Message:
    """Return the RADIO_STATUS of a modem's report."""
    return common.MAVLink_radio_status_message(
        report.rssi, report.remrssi, report.txbuf, report.noise, report.remnoise, report.rxerrors,
        report.fixed,
    )  # fmt: skip


def modem_encoder() -> Encoder:
    """Return the encoder of a modem's RADIO_STATUS."""
    return Encoder(system=MODEM_SYSTEM, component=MODEM_COMPONENT)


class SerialCarrier:
    """The carrier of a link to the ground station ``name`` with the station number ``station``."""

    def __init__(self, name: str, station: int) -> None:
        self.counts = {name: SerialCounts()}
        """By the station's name."""
        self._counts = self.counts[name]
        self._station = station
        self.defaults = (station,)
        self.now_us = 0
        """Simulated time of the bytes that are sent next."""
        self.foreign = 0
        """0: no other station can send to the modem."""
        self._received: deque[bytes] = deque(maxlen=_MOST_WAITING)
        self._reports: list[SerialReport] = []
        self._items: list[TxItem] = []
        self._sequence = FIRST_SEQUENCE

    @property
    def has_received(self) -> bool:
        """Whether there are bytes for `receive`."""
        return bool(self._received)

    def take_in(self, items: Sequence[RxItem]) -> list[RxItem]:
        """Take what is of the modem among the items that the radio returned; return the others."""
        others: list[RxItem] = []
        for item in items:
            match item:
                case SerialReceived():
                    self._counts.received_bytes += len(item.payload)
                    self._received.append(item.payload)
                case SerialReport():
                    self._counts.radio_status += 1
                    self._reports.append(item)
                case _:
                    others.append(item)
        return others

    def take_reports(self) -> list[SerialReport]:
        """Return the modem's reports since the last call."""
        reports, self._reports = self._reports, []
        return reports

    def take_out(self) -> tuple[TxItem, ...]:
        """Return the bytes to be sent, and forget them."""
        items, self._items = tuple(self._items), []
        return items

    # ---- see `autopilot.mavlink.links.Carrier`

    @staticmethod
    def wall_s() -> float:
        """Return 0: budgets follow simulated time, so that a flight depends on nothing else."""
        return 0.0

    def receive(self) -> tuple[bytes, int] | None:
        """Return the next bytes and the number of the station that sent them."""
        return (self._received.popleft(), self._station) if self._received else None

    def send(self, datagram: bytes | bytearray, address: int) -> None:
        """Write a datagram to the modem."""
        self._items.append(
            SerialBytes(seq=self._sequence, at_us=self.now_us, peer=address, payload=bytes(datagram))
        )
        self._sequence += 1
        self._counts.sent_bytes += len(datagram)

    @staticmethod
    def take_unreachable(*, look: bool = False) -> Sequence[int]:  # noqa: ARG004  as any carrier
        """Return none: a modem does not report that there is no other end."""
        return ()

    @staticmethod
    def trusts(sender: int, wall_s: float) -> bool:  # noqa: ARG004  as any carrier
        """Return True."""
        return True

    @staticmethod
    def may_send(address: int, wall_s: float, *, has_sent: bool) -> bool:  # noqa: ARG004  as any carrier
        """Return True."""
        return True

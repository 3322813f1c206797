"""Datagrams of a link as bytes of the vehicle's serial modem. No I/O.

The other modem of the pair is at the ground station. Nothing is acknowledged. The modem reports RADIO_STATUS
after each heartbeat that it has sent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.station_carrier import StationCarrier
from netsim.wire.messages import RxItem, SerialBytes, SerialReceived, SerialReport

MODEM_SYSTEM, MODEM_COMPONENT = ord("3"), ord("D")
"""Source of the modem's RADIO_STATUS, as the firmware SiK sets it (Firmware/radio/mavlink.c)."""


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


class SerialCarrier(StationCarrier):
    """The carrier of a link to the ground station ``name`` with the station number ``station``."""

    def __init__(self, name: str, station: int) -> None:
        super().__init__((station,))
        self.counts = {name: SerialCounts()}
        """By the station's name."""
        self._counts = self.counts[name]
        self._station = station
        self._reports: list[SerialReport] = []

    def take_in(self, items: Sequence[RxItem]) -> list[RxItem]:
        """Take what is of the modem among the items that the radio returned; return the others."""
        others: list[RxItem] = []
        for item in items:
            match item:
                case SerialReceived():
                    self._counts.received_bytes += len(item.payload)
                    self._received.append((item.payload, self._station))
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

    def send(self, datagram: bytes | bytearray, address: int) -> None:
        """Write a datagram to the modem."""
        self._queue(SerialBytes(seq=self._sequence, at_us=self.now_us, peer=address, payload=bytes(datagram)))
        self._counts.sent_bytes += len(datagram)

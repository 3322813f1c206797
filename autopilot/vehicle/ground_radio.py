"""The ground link of a vehicle over its radio, which it shares with the application. No sockets."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from autopilot.mavlink.codec import Message
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.links import MavlinkLink
from autopilot.mavlink.radio_carrier import RadioCarrier
from autopilot.mavlink.serial_carrier import SerialCarrier, modem_encoder, radio_status
from autopilot.parameters.config import VehicleConfig
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.link_settings import LinkSettings
from netsim.wire.messages import RxItem, TxItem

MOST_HELD = 256


class GroundRadio:
    """MAVLink between a vehicle and the ground stations of its radio or modem; ``tap``: see `MavlinkLink`."""

    def __init__(
        self, config: VehicleConfig, settings: LinkSettings, *, tap: Callable[[bytes], None] | None
    ) -> None:
        self._serial: SerialCarrier | None = None
        self._carrier: RadioCarrier | SerialCarrier
        if config.serial_modem:
            ((name, station),) = config.ground_stations.items()
            self._carrier = self._serial = SerialCarrier(name, station)
        else:
            self._carrier = RadioCarrier(config.ground_stations)
        self._link = MavlinkLink(
            self._carrier, encoder=settings.encoder(), signer=settings.signer(GROUND_STATION),
            budget=InputBudget(), tap=tap, is_stream=config.serial_modem,
        )  # fmt: skip
        self._tap, self._modem_encoder = tap, modem_encoder()
        self._held: list[Addressed] = []
        """Messages that wait for simulated time to go on, at most `MOST_HELD`; the oldest are dropped."""
        self.received = 0
        """Number of messages received."""

    @property
    def active(self) -> bool:
        """Whether telemetry is streamed: from the first heartbeat on, to all ground stations."""
        return self._link.active

    def take_in(self, items: Sequence[RxItem]) -> list[RxItem]:
        """Take what is of the link among the radio's items; return the others, for the application."""
        return self._carrier.take_in(items)

    def receive(self, now_us: int) -> list[Addressed]:
        """Return the messages that have arrived."""
        if not self._carrier.has_received:
            return []
        messages = [
            Addressed(Partner(GROUND_STATION, number), message)
            for number, message in self._link.receive(now_us)
        ]
        self.received += len(messages)
        return messages

    def take_status(self) -> list[Message]:
        """Return the RADIO_STATUS messages of the vehicle's modem since the last call; none without one.

        They do not pass the link's parser: a modem does not sign.
        """
        if self._serial is None:
            return []
        messages = [radio_status(report) for report in self._serial.take_reports()]
        if self._tap is not None:
            for message in messages:
                self._tap(self._modem_encoder.encode(message))
        return messages

    def hold(self, messages: Sequence[Addressed]) -> None:
        """Keep the ground link's messages of a pause until the next `send`."""
        own = [each for each in messages if each.partner.link == GROUND_STATION]
        self._held = (self._held + own)[-MOST_HELD:]

    def send(self, now_us: int, messages: Sequence[Addressed]) -> tuple[TxItem, ...]:
        """Return the frames with the ground link's messages, and those held, as of ``now_us``."""
        if not (messages or self._held):
            return ()
        held, self._held = self._held, []
        self._carrier.now_us = now_us
        self._link.send(
            [
                (each.partner.number, each.message)
                for each in (*held, *messages)
                if each.partner.link == GROUND_STATION
            ]
        )
        return self._carrier.take_out()

    def counts(self) -> dict[str, Any]:
        """Return the counts of rejected input by cause, and those of the carrier by ground station.

        The latter are an entry ``frames`` with those of 802.11, or ``serial`` with those of the modem.
        """
        counters = self._link.counters
        counters.datagrams_foreign = self._carrier.foreign
        carried = {name: asdict(counts) for name, counts in self._carrier.counts.items()}
        return {**asdict(counters), "frames" if self._serial is None else "serial": carried}

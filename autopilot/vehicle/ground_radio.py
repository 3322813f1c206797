"""The ground link of a vehicle over its radio, which it shares with the application. No sockets."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.links import MavlinkLink
from autopilot.mavlink.radio_carrier import RadioCarrier
from autopilot.parameters.config import VehicleConfig
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.link_settings import LinkSettings
from netsim.wire.messages import RxItem, TxItem


class GroundRadio:
    """MAVLink between a vehicle and the ground stations of its radio; ``tap`` is that of `MavlinkLink`."""

    def __init__(
        self, config: VehicleConfig, settings: LinkSettings, *, tap: Callable[[bytes], None] | None
    ) -> None:
        self._carrier = RadioCarrier(config.ground_stations)
        self._link = MavlinkLink(
            self._carrier, encoder=settings.encoder(), signer=settings.signer(GROUND_STATION),
            budget=InputBudget(), tap=tap,
        )  # fmt: skip
        self._held: list[Addressed] = []
        """Messages that wait for simulated time to go on."""
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

    def hold(self, messages: Sequence[Addressed]) -> None:
        """Keep the ground link's messages of a pause until the next `send`."""
        self._held += [each for each in messages if each.partner.link == GROUND_STATION]

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
        """Return the counts of rejected input by cause, and those of frames by ground station."""
        counters = self._link.counters
        counters.datagrams_foreign = self._carrier.foreign
        frames = {name: asdict(counts) for name, counts in self._carrier.counts.items()}
        return {**asdict(counters), "frames": frames}

"""A service and its stations over links that lose, duplicate and reorder messages, determined by a seed.

Virtual time advances from one arrival or deadline to the next, so the cost depends only on the number of
messages. A station is a state machine like a service, but has a single partner:
    on_message(message, now_us) -> messages     on_timer(now_us) -> messages
    next_deadline_us() -> int                   done: bool

    outcome = play(ParameterService(get, put), station, seed=3, loss=0.05)
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from autopilot.mavlink.codec import Encoder, Message, Parser, stamp
from autopilot.services.service import BROADCAST, GROUND_STATION, Addressed, MavlinkService, Partner

STATION_SYSTEM, STATION_COMPONENT = 255, 190
VEHICLE_SYSTEM = 1
STEP_US = 4_000
"""The service's timers run at its next step, as in a vehicle."""


class Station(Protocol):
    """A client of the service."""

    @property
    def done(self) -> bool:
        """Whether it has ended, successfully or not."""
        ...

    def on_message(self, message: Message, now_us: int) -> Sequence[Message]: ...

    def on_timer(self, now_us: int) -> Sequence[Message]: ...

    def next_deadline_us(self) -> int: ...


@dataclass
class Outcome:
    """Result of `play`."""

    now_us: int = 0
    sent: int = 0
    lost: int = 0
    copies: int = 0
    """Duplicates made by the link."""
    from_service: list[tuple[int, int, Message]] = field(default_factory=list)
    """Time, number of the station, and message; before loss."""


class _Air:
    """Messages in transit; each copy has its own random delay, so that they overtake each other."""

    def __init__(self, seed: int, loss: float, duplication: float, delays_us: tuple[int, int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._loss, self._duplication, self._delays_us = loss, duplication, delays_us
        self._flying: list[tuple[int, int, int, Message]] = []
        self._serial = 0

    def send(self, where: int, message: Message, now_us: int, outcome: Outcome) -> None:
        outcome.sent += 1
        copies = 1
        if self._rng.random() < self._duplication:
            copies, outcome.copies = 2, outcome.copies + 1
        for _ in range(copies):
            if self._rng.random() < self._loss:
                outcome.lost += 1
                continue
            delay_us = int(self._rng.integers(self._delays_us[0], self._delays_us[1] + 1))
            self._serial += 1
            heapq.heappush(self._flying, (now_us + delay_us, self._serial, where, message))

    def next_us(self) -> int | None:
        return self._flying[0][0] if self._flying else None

    def arrivals(self, now_us: int) -> list[tuple[int, Message]]:
        arrived = []
        while self._flying and self._flying[0][0] <= now_us:
            _, _, where, message = heapq.heappop(self._flying)
            arrived.append((where, message))
        return arrived


_TO_SERVICE = 1_000
"""Added to a station's number in messages to the service."""


def play(
    service: MavlinkService,
    *stations: Station,
    seed: int = 0,
    loss: float = 0.0,
    duplication: float = 0.0,
    delays_us: tuple[int, int] = (0, 0),
    limit_us: int = 600_000_000,
    start_us: int = 0,
    after_us: int = 0,
    packed: bool = False,
) -> Outcome:
    """Run stations with a service until all are done, and ``after_us`` longer, or until the limit.

    ``loss`` and ``duplication`` are probabilities per message, loss also per copy; delays are uniform within
    ``delays_us``. A ``packed`` message is encoded and parsed. The station at index n is
    Partner(GROUND_STATION, n); messages of the service to other links are dropped.
    """
    air = _Air(seed, loss, duplication, delays_us)
    outcome = Outcome(now_us=start_us)
    end_us = start_us + limit_us
    wires = [_Wire(packed=packed) for _ in range(len(stations) + 1)]

    def from_station(number: int, messages: Sequence[Message]) -> None:
        for message in messages:
            sent = wires[number].carry(message, STATION_SYSTEM, STATION_COMPONENT)
            air.send(_TO_SERVICE + number, sent, now_us, outcome)

    def from_service(messages: Sequence[Addressed]) -> None:
        for partner, message in messages:
            if partner.link not in {GROUND_STATION, BROADCAST}:
                continue
            sent = wires[-1].carry(message, VEHICLE_SYSTEM, 1)
            for number in range(len(stations)) if partner.number == BROADCAST else (partner.number,):
                outcome.from_service.append((now_us, number, sent))
                air.send(number, sent, now_us, outcome)

    now_us, stop_us = start_us, None
    while now_us <= end_us and (stop_us is None or now_us <= stop_us):
        outcome.now_us = now_us
        for where, message in air.arrivals(now_us):
            if where < _TO_SERVICE:
                from_station(where, stations[where].on_message(message, now_us))
            elif message.get_msgId() in service.takes:
                number = where - _TO_SERVICE
                from_service(service.on_message(message, now_us, Partner(GROUND_STATION, number)))
        for number, station in enumerate(stations):
            if now_us >= station.next_deadline_us():
                from_station(number, station.on_timer(now_us))
        if now_us >= service.next_deadline_us():
            from_service(service.on_timer(now_us))
        if stop_us is None and all(station.done for station in stations):
            stop_us = now_us + after_us
        step_us = now_us + STEP_US
        due_us = [max(service.next_deadline_us(), step_us)]
        due_us += [max(station.next_deadline_us(), now_us + 1) for station in stations]
        arrival_us = air.next_us()
        if arrival_us is not None:
            due_us.append(max(arrival_us, now_us))
        now_us = min(due_us)
    return outcome


class _Wire:
    """Sets the source of a message, by encoding and parsing it if ``packed``."""

    def __init__(self, *, packed: bool) -> None:
        self._packed = packed
        self._encoder: Encoder | None = None
        self._parser = Parser()

    def carry(self, message: Message, system: int, component: int) -> Message:
        if not self._packed:
            return stamp(message, system=system, component=component)
        if self._encoder is None:
            self._encoder = Encoder(system=system, component=component)
        (parsed,) = self._parser.push_datagram(self._encoder.encode(message))
        return parsed

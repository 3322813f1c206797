"""Offboard setpoints: the latest of each source, and the selection of the source.

Application, companion and ground stations may all send at once. The source that last requested Offboard is
selected; while it sends nothing fresh, the source of the newest setpoint is. While Offboard is flown the
selection changes only on a request, so that one source's stream does not keep alive another's. A message that
is no valid setpoint is dropped and counted; it does not keep offboard mode alive.
"""

from collections.abc import Sequence

from autopilot.commander.failsafe import US_PER_S
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode
from autopilot.services.flight_data import FlightData
from autopilot.services.service import Addressed, Partner, Service
from autopilot.services.setpoint_messages import SETPOINT_MESSAGES, decode
from foundation.types import Setpoint

_SOURCES_MAX = 8
"""Sources that are stored; a new one replaces the one that has been silent longest."""


_Received = tuple[Setpoint, int]
"""A source's latest setpoint, and its time of arrival"""


class OffboardService(Service):
    """Setpoints of all sources. Call `ask` before a switch to Offboard, `is_fresh` before decisions."""

    def __init__(self, flight: FlightData) -> None:
        super().__init__()
        self.takes = SETPOINT_MESSAGES
        self._flight = flight
        self.rejected = 0
        """Count of messages that were no valid setpoint."""
        self._received: dict[Partner, _Received] = {}
        self.source: Partner | None = None
        """The selected source; None before the first setpoint."""
        self.setpoint: Setpoint | None = None
        """The latest setpoint of the selected source."""
        self.received_us: int | None = None
        """Time of its arrival."""
        self._requester: Partner | None = None
        self._timeout_us = round(flight.commander.params.offboard_loss_s * US_PER_S)

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether the selected source has sent within ``timeout_us``, the new limit of freshness."""
        self._timeout_us = timeout_us
        if not self._is_flown:
            self._choose(now_us)
        return self.received_us is not None and now_us - self.received_us <= timeout_us

    def ask(self, partner: Partner, now_us: int) -> None:
        """Record a request for Offboard: the partner is selected if its setpoints are fresh.

        Otherwise the selected source stays while it is fresh, as when the operator at a ground station
        switches to Offboard for the companion's program.
        """
        self._requester = partner
        if self._is_fresh(partner, now_us) or not self._is_fresh(self.source, now_us):
            self._choose(now_us)

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Store a setpoint; there is no answer."""
        setpoint = decode(message, self._flight)
        if setpoint is None:
            self.rejected += 1
            return ()
        self._received[partner] = (setpoint, now_us)
        if len(self._received) > _SOURCES_MAX:
            del self._received[min(self._idle_sources(), key=self._time_us)]
        if not self._is_flown:
            self._choose(now_us)
        elif partner == self.source:
            self.setpoint, self.received_us = setpoint, now_us
        return ()

    @property
    def _is_flown(self) -> bool:
        commander = self._flight.commander
        return commander.armed and commander.mode is FlightMode.OFFBOARD

    def _is_fresh(self, source: Partner | None, now_us: int) -> bool:
        received = None if source is None else self._received.get(source)
        return received is not None and now_us - received[1] <= self._timeout_us

    def _choose(self, now_us: int) -> None:
        """Select the requester while it is fresh, else the source of the newest setpoint, fresh or not."""
        if self._is_fresh(self._requester, now_us):
            self.source = self._requester
        elif self._received:
            self.source = max(self._received, key=self._time_us)
        if self.source is not None:
            self.setpoint, self.received_us = self._received[self.source]

    def _time_us(self, source: Partner) -> int:
        return self._received[source][1]

    def _idle_sources(self) -> list[Partner]:
        return [source for source in self._received if source != self.source]

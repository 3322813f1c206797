"""Offboard setpoints: the newest of every source, and whose count.

Application, companion and ground stations may all send at once. The source counts that asked for Offboard
last; as long as it sends nothing fresh, the newest of the others, until Offboard is flown: from then on
another one counts only when it asks. So no stream is kept alive by somebody else's. A message that is no
setpoint is dropped and counted; it does not keep offboard mode alive.
"""

from collections.abc import Sequence

from autopilot.commander.failsafe import US_PER_S
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode
from autopilot.services.flight_data import FlightData
from autopilot.services.service import Addressed, Listener, Partner
from autopilot.services.setpoint_messages import SETPOINT_MESSAGES, decode
from foundation.types import Setpoint

_SOURCES_MAX = 8
"""Of more, the one that has been silent longest is forgotten."""


_Received = tuple[Setpoint, int]
"""A source's newest setpoint, and when it came"""


class OffboardService(Listener):
    """Setpoints of all sources: `ask` before Offboard is asked for, `is_fresh` before decisions."""

    takes = SETPOINT_MESSAGES

    def __init__(self, flight: FlightData) -> None:
        self._flight = flight
        self.rejected = 0
        """Messages that were no setpoint."""
        self._received: dict[Partner, _Received] = {}
        self._counts: Partner | None = None
        """The source that is flown by, or would be."""
        self.setpoint: Setpoint | None = None
        """The newest of the source that counts."""
        self.received_us: int | None = None
        """When that came."""
        self._asker: Partner | None = None
        self._timeout_us = round(flight.commander.params.offboard_loss_s * US_PER_S)

    @property
    def source(self) -> Partner | None:
        """Whose setpoints count; None before any came."""
        return self._counts

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether the source that counts has sent within ``timeout_us``, which is what fresh means."""
        self._timeout_us = timeout_us
        if not self._is_flown:
            self._choose(now_us)
        return self.received_us is not None and now_us - self.received_us <= timeout_us

    def ask(self, partner: Partner, now_us: int) -> None:
        """Note who is about to ask for Offboard: its setpoints count if they are fresh.

        Else whoever counts goes on as long as that is fresh, as when a station's button is pressed for the
        companion's program.
        """
        self._asker = partner
        if self._is_fresh(partner, now_us) or not self._is_fresh(self._counts, now_us):
            self._choose(now_us)

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Take a setpoint; nothing is answered."""
        setpoint = decode(message, self._flight)
        if setpoint is None:
            self.rejected += 1
            return ()
        self._received[partner] = (setpoint, now_us)
        if len(self._received) > _SOURCES_MAX:
            del self._received[min(self._idle_sources(), key=self._time_us)]
        if not self._is_flown:
            self._choose(now_us)
        elif partner == self._counts:
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
        """Let the asker count while it is fresh, else the source of the newest setpoint, fresh or not."""
        if self._is_fresh(self._asker, now_us):
            self._counts = self._asker
        elif self._received:
            self._counts = max(self._received, key=self._time_us)
        if self._counts is not None:
            self.setpoint, self.received_us = self._received[self._counts]

    def _time_us(self, source: Partner) -> int:
        return self._received[source][1]

    def _idle_sources(self) -> list[Partner]:
        return [source for source in self._received if source != self._counts]

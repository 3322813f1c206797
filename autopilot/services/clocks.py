"""TIMESYNC and PING: requests that are answered at once, so that the sender can measure the link's delay."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.flight_data import FlightData
from autopilot.services.service import Addressed, Partner, Service, reply

_NS_PER_US = 1_000


class TimesyncService(Service):
    """Answers TIMESYNC with the time since the start, in ns; answers to its own requests are ignored."""

    def __init__(self, flight: FlightData) -> None:
        super().__init__(TIMESYNC=self._answer)
        self._flight = flight

    def _answer(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request, which has no time of the responder."""
        if message.tc1 != 0:
            return ()
        return reply(partner, common.MAVLink_timesync_message(now_us * _NS_PER_US, message.ts1))

    def question(self) -> Message:
        """Return a request to the other side, as PX4 sends on a companion's link."""
        return common.MAVLink_timesync_message(0, self._flight.now_us * _NS_PER_US)


class PingService(Service):
    """Answers broadcast PINGs; one that targets this vehicle is the answer to its own request."""

    def __init__(self, flight: FlightData) -> None:
        super().__init__(PING=self._answer)
        self._flight = flight
        self._seq = 0

    def _answer(self, message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer with the request's number and time."""
        if message.target_system != 0 or message.target_component != 0:
            return ()
        target = (message.get_srcSystem(), message.get_srcComponent())
        return reply(partner, common.MAVLink_ping_message(message.time_usec, message.seq, *target))

    def question(self) -> Message:
        """Return a broadcast request."""
        self._seq = (self._seq + 1) % 2**32
        return common.MAVLink_ping_message(self._flight.now_us, self._seq, 0, 0)

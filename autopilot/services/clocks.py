"""TIMESYNC and PING: requests that are answered at once, so that the sender can measure the link's delay."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.flight_data import FlightData
from autopilot.services.service import Addressed, Listener, Partner, reply

_NS_PER_US = 1_000


class TimesyncService(Listener):
    """Answers TIMESYNC with the time since the start, in ns; answers to its own requests are ignored."""

    takes = frozenset({common.MAVLINK_MSG_ID_TIMESYNC})

    def __init__(self, flight: FlightData) -> None:
        self._flight = flight

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request, which has no time of the responder."""
        if message.tc1 != 0:
            return ()
        return reply(partner, common.MAVLink_timesync_message(now_us * _NS_PER_US, message.ts1))

    def question(self) -> Message:
        """Return a request to the other side, as PX4 sends on a companion's link."""
        return common.MAVLink_timesync_message(0, self._flight.now_us * _NS_PER_US)


class PingService(Listener):
    """Answers broadcast PINGs; one that targets this vehicle is the answer to its own request."""

    takes = frozenset({common.MAVLINK_MSG_ID_PING})

    def __init__(self, flight: FlightData) -> None:
        self._flight = flight
        self._seq = 0

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """Answer with the request's number and time."""
        if message.target_system != 0 or message.target_component != 0:
            return ()
        return reply(
            partner,
            common.MAVLink_ping_message(
                message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
            ),
        )

    def question(self) -> Message:
        """Return a broadcast request."""
        self._seq = (self._seq + 1) % 2**32
        return common.MAVLink_ping_message(self._flight.now_us, self._seq, 0, 0)

"""Check that an ArduPilot has the scenario's parameters: it ignores unknown ones without a word. No I/O."""

from collections.abc import Iterable

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT

PERIOD_US = 1_000_000
"""Period of the requests."""
REQUESTS = 5
"""Number of requests without an answer after which parameters count as unknown."""
MOST_AT_ONCE = 16
"""Parameters of a request: ArduPilot stores 20 and drops the others."""


class ParameterCheck:
    """Requests parameters from the first HEARTBEAT on, each until its value arrives or it counts as unknown.

    ``encoder`` is that of the MAVLink link.
    """

    def __init__(self, names: Iterable[str], *, target_system: int, encoder: Encoder) -> None:
        self._target_system = target_system
        self._encoder = encoder
        self._missing = list(names)
        self._unknown: list[str] = []
        """Unknown ones that `unknown` has not returned yet."""
        self._requests = 0
        """Requests since the last answer."""
        self._due_us: int | None = None
        """Time of the next request; None before the first HEARTBEAT."""

    def on_message(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot."""
        kind = message.get_msgId()
        if kind == common.MAVLINK_MSG_ID_HEARTBEAT and self._due_us is None:
            self._due_us = now_us
        elif kind == common.MAVLINK_MSG_ID_PARAM_VALUE and message.param_id in self._missing:
            self._missing.remove(message.param_id)
            self._requests = 0

    def requests(self, now_us: int) -> bytes:
        """Return PARAM_REQUEST_READ of missing parameters, if they are due; else nothing."""
        if not self._missing or self._due_us is None or now_us < self._due_us:
            return b""
        self._due_us = now_us + PERIOD_US
        if self._requests == REQUESTS:
            self._unknown += self._missing[:MOST_AT_ONCE]
            del self._missing[:MOST_AT_ONCE]
            self._requests = 0
        self._requests += 1
        return b"".join(map(self._request, self._missing[:MOST_AT_ONCE]))

    def unknown(self) -> list[str]:
        """Return the parameters that the autopilot does not have, once each, when this is known."""
        unknown, self._unknown = self._unknown, []
        return unknown

    def _request(self, name: str) -> bytes:
        return self._encoder.encode(
            common.MAVLink_param_request_read_message(
                self._target_system, AUTOPILOT_COMPONENT, name.encode("ascii"), -1
            )
        )

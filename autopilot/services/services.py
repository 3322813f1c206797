"""All services of a vehicle behind one interface: dispatch of messages and the earliest deadline."""

from collections.abc import Sequence

from autopilot.mavlink.codec import Message
from autopilot.services.service import Addressed, MavlinkService, Partner


class Services:
    """A vehicle's services. A message is passed to all that handle its id, in the order given."""

    def __init__(self, services: Sequence[MavlinkService]) -> None:
        self._services = tuple(services)
        self._of_kind: dict[int, list[MavlinkService]] = {}
        for service in services:
            for kind in service.takes:
                self._of_kind.setdefault(kind, []).append(service)
        self.deadline_us = 0
        """Time of the next `on_timer` that has work, in us."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> list[Addressed]:
        """Answers to a message that is addressed to the autopilot."""
        answers: list[Addressed] = []
        for service in self._of_kind.get(message.get_msgId(), ()):
            answers += service.on_message(message, now_us, partner)
            self.deadline_us = min(self.deadline_us, service.next_deadline_us())
        return answers

    def on_timer(self, now_us: int) -> list[Addressed]:
        """Messages of all services whose deadline has passed."""
        messages: list[Addressed] = []
        for service in self._services:
            if now_us >= service.next_deadline_us():
                messages += service.on_timer(now_us)
        self.look_again()
        return messages

    def look_again(self) -> None:
        """Recompute the deadline after a service was changed by something other than a message."""
        self.deadline_us = min(service.next_deadline_us() for service in self._services)

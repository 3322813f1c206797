"""All services of a vehicle as one: who takes a message, and when the next of them has something to do."""

from collections.abc import Sequence

from autopilot.mavlink.codec import Message
from autopilot.services.service import Addressed, Partner, Service


class Services:
    """Services, each in the vehicle once; a message goes to those that take its kind, in their order."""

    def __init__(self, services: Sequence[Service]) -> None:
        self._services = tuple(services)
        self._of_kind: dict[int, list[Service]] = {}
        for service in services:
            for kind in service.takes:
                self._of_kind.setdefault(kind, []).append(service)
        self.deadline_us = 0
        """When `on_timer` next has something to do."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> list[Addressed]:
        """Answers to a message that is meant for the autopilot."""
        answers: list[Addressed] = []
        for service in self._of_kind.get(message.get_msgId(), ()):
            answers += service.on_message(message, now_us, partner)
            self.deadline_us = min(self.deadline_us, service.next_deadline_us())
        return answers

    def on_timer(self, now_us: int) -> list[Addressed]:
        """Whatever is due."""
        messages: list[Addressed] = []
        for service in self._services:
            if now_us >= service.next_deadline_us():
                messages += service.on_timer(now_us)
        self.look_again()
        return messages

    def look_again(self) -> None:
        """Ask the services anew when they are due, after something other than a message changed one."""
        self.deadline_us = min(service.next_deadline_us() for service in self._services)

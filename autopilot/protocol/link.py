"""One MAVLink partner of the vehicle: its streams and the services that answer it."""

from collections.abc import Sequence

from autopilot.mavlink.codec import Message
from autopilot.protocol.parameter import ParameterService
from autopilot.protocol.service import Service
from autopilot.protocol.streams import Streams


class Link:
    """Ground station, companion, or the application in this process; ``services`` beside the streams."""

    def __init__(self, streams: Streams, parameters: ParameterService, services: Sequence[Service]) -> None:
        self.streams = streams
        self._parameters = parameters
        self._services = (*services, parameters)
        self.deadline_us = 0
        """When `on_timer` next has something to do."""

    def set_active(self, *, active: bool) -> None:
        """Say whether somebody listens; without, only the heartbeat is formed."""
        if active is not self.streams.active:
            self.streams.active = active
            self._note_deadline()

    def on_new_data(self, message_id: int) -> None:
        """Note that a message has something new to say."""
        self.streams.on_new_data(message_id)
        self._note_deadline()

    def on_message(self, message: Message, now_us: int) -> list[Message]:
        """Answers to a message that is meant for the autopilot."""
        answers = [answer for service in self._services for answer in service.on_message(message, now_us)]
        self._note_deadline()
        return answers

    def on_timer(self, now_us: int) -> list[Message]:
        """Whatever is due."""
        messages = list(self.streams.on_timer(now_us))
        if now_us >= self._parameters.next_deadline_us():
            messages += self._parameters.on_timer(now_us)
        self._note_deadline()
        return messages

    def _note_deadline(self) -> None:
        self.deadline_us = min(self.streams.next_deadline_us(), self._parameters.next_deadline_us())

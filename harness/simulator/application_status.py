"""Status of one vehicle's on-board application, from the messages that it sends about itself."""

import math
from typing import Literal

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.onboard.application import Layout
from autopilot.onboard.programs import START_NAME, VALUES_NAME
from harness.simulator.motion_start import start_us

_START = START_NAME.decode("ascii")
_VALUES = VALUES_NAME.decode("ascii")
Aim = Literal["unknown", "ahead", "reached", "dropped"]


class ApplicationStatus:
    """The newest status; all is unknown before the first message, and after `forget`."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.phase: int | None = None
        self.motion_start_us: int | None = None
        """Start of the formation's motion that it reports."""
        self.text = ""
        self.values: dict[str, float] = {}
        """Numbers that it reports, without those that are not finite."""

    def on_message(self, message: Message) -> None:
        """Process a message of the application; other kinds and unknown phases are ignored."""
        match message.get_msgId():
            case common.MAVLINK_MSG_ID_HEARTBEAT:
                if message.custom_mode in self._layout.phases:
                    self.phase = message.custom_mode
            case common.MAVLINK_MSG_ID_NAMED_VALUE_INT:
                if message.name == _START:
                    self.motion_start_us = start_us(message.value)
            case common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY:
                if message.name == _VALUES:
                    named = zip(self._layout.values, message.data, strict=False)
                    self.values = {name: value for name, value in named if math.isfinite(value)}
            case common.MAVLINK_MSG_ID_STATUSTEXT:
                if message.severity == common.MAV_SEVERITY_INFO:
                    self.text = message.text

    def forget(self) -> None:
        """Forget the status of an application that has ended."""
        self.phase = None

    @property
    def phase_text(self) -> str:
        """Name of the phase; empty while it is unknown."""
        return "" if self.phase is None else self._layout.phases[self.phase]

    @property
    def aim(self) -> Aim:
        """Whether the application has reached its aim."""
        if self.phase is None or not self._layout.formed:
            return "unknown"
        if self.phase in self._layout.absent:
            return "dropped"
        return "reached" if self.phase in self._layout.formed else "ahead"

    @property
    def is_placed(self) -> bool:
        """Whether it flies to its place of the formation, or is there."""
        return self.phase in self._layout.placed

"""All programs of one UAV, as vehicles and companions call them. No I/O.

`Programs` is what a vehicle's process, or a companion beside a PX4 or ArduPilot, calls. It passes messages
and radio items to the programs, datagrams by their port, and returns what they send.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.onboard.application import MOST_VALUES, Application, Estimate, Layout, Status
from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.program import Program
from netsim.wire.messages import Delivery, RxItem, TxItem

MANY_ITEMS = 1_000
"""Transmissions of one iteration beyond which a program floods its radio's queue, which is reported once."""
HEARTBEAT_PERIOD_US = 1_000_000
VALUES_PERIOD_US = 200_000
"""Period of the numbers of a status on links and to the simulator; logs have those of each row."""
START_NAME = b"start_ms"
"""Name of the NAMED_VALUE_INT with the start of the formation's motion, ms of simulated time."""
VALUES_NAME = b"app"
"""Name of the DEBUG_FLOAT_ARRAY with the numbers of the statuses, in the order of `Layout.values`."""


class OnboardOutput(Struct, frozen=True):
    """What the programs of a UAV send in one iteration of their loop."""

    mavlink: Sequence[Message | PositionTarget]
    """Messages to the autopilot of the same UAV; `PositionTarget` is the setpoint of offboard mode."""
    radio: tuple[TxItem, ...]
    """Datagrams and ranging requests, with send times from now until the next iteration."""


NOTHING: Final = OnboardOutput((), ())
"""Output of an iteration in which nothing is due."""


class Programs:
    """The programs of one UAV, which share ``autopilot`` and the sequence numbers of the radio.

    The first of ``programs`` flies the UAV: phase, estimate and answers are its own.
    """

    def __init__(self, programs: Sequence[Program], autopilot: AutopilotClient, layout: Layout) -> None:
        self.layout = layout
        self._first, *self._others = programs
        self._all = tuple(programs)
        self._autopilot = autopilot
        self._reported: tuple[int, int | None] | None = None
        """Phase and start of the motion in the last heartbeat."""
        self._heartbeat_us = self._values_us = 0
        self._statuses: list[Status | None] = [None] * len(programs)
        """Statuses in the last report."""
        self._texts = [""] * len(programs)
        self._flooding: set[Program] = set()
        """Programs that have been reported."""

    @property
    def application(self) -> Application:
        """The application that flies the UAV."""
        return self._first.application

    @property
    def needs_truth(self) -> bool:
        """Whether the simulator's true state is passed on."""
        return any(program.context.needs_truth for program in self._all)

    @property
    def status(self) -> Status:
        """Status of the application that flies the UAV."""
        return self._first.status

    @property
    def phase(self) -> int:
        """Its phase."""
        return self._first.status.phase

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers of all statuses, in the order of `Layout.values`; NaN where there is none."""
        names = self.layout.values
        if not names:
            return ()
        found: dict[str, float] = {}
        for program in self._all:
            found |= program.values
        return tuple([found.get(name, math.nan) for name in names])

    def on_mavlink(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot."""
        self._autopilot.on_message(message, now_us)
        for program in self._all:
            program.on_mavlink(message, now_us)

    def on_request(self, message: Message) -> Sequence[Message]:
        """Return the answers to a message that a station addressed to the UAV's applications."""
        return [answer for program in self._all for answer in program.on_request(message)]

    def on_radio(self, items: Sequence[RxItem], now_us: int) -> None:
        """Pass on what the radio received and measured: datagrams by port, results by sequence number."""
        if not self._others:
            port = self._first.context.radio.port
            mine = [item for item in items if type(item) is not Delivery or item.port == port]
            self._first.on_radio(mine, now_us)
            return
        for program in self._all:
            radio = program.context.radio
            mine = [item for item in items if radio.is_for(item)]
            if mine:
                program.on_radio(mine, now_us)

    def on_timer(self, now_us: int) -> OnboardOutput:
        """Run one iteration and return everything to send."""
        self._autopilot.begin(now_us)
        radio: tuple[TxItem, ...] = ()
        for program in self._all:
            program.context.radio.now_us = now_us
            program.on_timer(now_us)
            items = program.context.radio.take()
            if len(items) > MANY_ITEMS and program not in self._flooding:
                self._flooding.add(program)
                program.context.warn(f"{program.title} sends {len(items)} items at once: most are dropped")
            radio += items
        mavlink = self._autopilot.take(now_us)
        mavlink += self._report(now_us)
        return OnboardOutput(mavlink, radio) if mavlink or radio else NOTHING

    def estimate(self, now_us: int) -> Estimate:
        """Return the position estimate of the application that flies the UAV."""
        return self._first.estimate(now_us)

    def troubles(self) -> Mapping[str, int]:
        """Return counts of the faults that were handled; those of others begin with the program's name."""
        counts = {**self._first.troubles()}
        for program in self._others:
            counts |= {f"{program.name}_{what}": count for what, count in program.troubles().items()}
        return counts

    def _report(self, now_us: int) -> list[Message]:
        """Return the messages with the statuses that are due."""
        status, messages = self._first.status, []
        reported = self._reported
        if status is not self._statuses[0]:
            reported = (int(status.phase), status.motion_start_us)
        if reported != self._reported or now_us >= self._heartbeat_us:
            self._reported = reported
            self._heartbeat_us = now_us + HEARTBEAT_PERIOD_US
            messages.append(_heartbeat(status))
            if status.motion_start_us is not None:
                start_ms = status.motion_start_us // 1_000
                messages.append(common.MAVLink_named_value_int_message(now_us // 1_000, START_NAME, start_ms))
        if self.layout.values and now_us >= self._values_us:
            self._values_us = now_us + VALUES_PERIOD_US
            unused = [0.0] * (MOST_VALUES - len(self.layout.values))
            values = (*self.values, *unused)
            messages.append(common.MAVLink_debug_float_array_message(now_us, VALUES_NAME, 0, values))
        for number, program in enumerate(self._all):
            if program.status is not self._statuses[number]:
                self._statuses[number] = program.status
                text = program.status.text
                if text and text != self._texts[number]:
                    messages.append(_text(common.MAV_SEVERITY_INFO, text))
                self._texts[number] = text
            if warnings := program.context.take_warnings():
                messages += [_text(common.MAV_SEVERITY_WARNING, each) for each in warnings]
        return messages


def _heartbeat(status: Status) -> Message:
    return common.MAVLink_heartbeat_message(
        common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, int(status.phase),
        common.MAV_STATE_ACTIVE, 3,
    )  # fmt: skip


def _text(severity: int, text: str) -> Message:
    return common.MAVLink_statustext_message(severity, text.encode("ascii", "replace"))

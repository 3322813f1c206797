"""The application of one UAV with its context, as vehicles and companions call it. No I/O.

`Programs` is what a vehicle's process, or a companion beside a PX4 or ArduPilot, calls. It passes messages
and radio items to the application, and returns what it sends. An exception of the user's code, or a wrong
value that it returns, is raised as ExtensionFailure.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Final, ParamSpec, TypeVar

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.onboard.application import Application, Estimate, Status
from autopilot.onboard.context import Context
from foundation.extension_failure import ExtensionFailure, failure
from netsim.wire.messages import RxItem, TxItem

P = ParamSpec("P")
R = TypeVar("R")

HEARTBEAT_PERIOD_US = 1_000_000
VALUES_PERIOD_US = 200_000
"""Period of the numbers of a status on links and to the simulator; logs have those of each row."""
START_NAME = b"start_ms"
"""Name of the NAMED_VALUE_INT with the start of the formation's motion, ms of simulated time."""
VALUES_NAME = b"app"
"""Name of the DEBUG_FLOAT_ARRAY with the numbers of a status, in the order of `Reports.values`."""


class OnboardOutput(Struct, frozen=True):
    """What the applications of a UAV send in one iteration of their loop."""

    mavlink: Sequence[Message | PositionTarget]
    """Messages to the autopilot of the same UAV; `PositionTarget` is the setpoint of offboard mode."""
    radio: tuple[TxItem, ...]
    """Datagrams and ranging requests, with send times from now until the next iteration."""


NOTHING: Final = OnboardOutput((), ())
"""Output of an iteration in which nothing is due."""


class Programs:
    """One application with its context.

    ``title`` begins the lines of its failures, such as ``onboard.application my_package.app:App``.
    """

    def __init__(self, application: Application, context: Context, *, title: str) -> None:
        self.application = application
        self._context = context
        self._title = title
        self._reports = application.reports
        self._call(application.start, context)
        self.status = self._checked(self._call(application.status))
        """Status after the last iteration."""
        self._reported: tuple[int, int | None] | None = None
        """Phase and start of the motion in the last heartbeat."""
        self._heartbeat_us = self._values_us = 0
        self._text = ""

    @property
    def needs_truth(self) -> bool:
        """Whether the simulator's true state is passed on."""
        return self._context.needs_truth

    @property
    def phase(self) -> IntEnum:
        """Phase of the flight, a member of `Reports.phases`."""
        return self.status.phase

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers of the status, in the order of `Reports.values`; NaN where it has none."""
        values = self.status.values
        return tuple(values.get(name, math.nan) for name in self._reports.values)

    def on_mavlink(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot."""
        self._context.autopilot.on_message(message, now_us)
        try:
            self.application.on_mavlink(message, now_us)
        except Exception as error:
            raise failure(self._title, error) from error

    def on_request(self, message: Message) -> Sequence[Message]:
        """Return the answers to a message that a station addressed to the application."""
        return list(self._call(self.application.on_request, message))

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:
        """Process what the radio received and measured."""
        self._call(self.application.on_radio, items, now_us)

    def on_timer(self, now_us: int) -> OnboardOutput:
        """Run one iteration and return everything to send."""
        context, application = self._context, self.application
        context.radio.now_us = now_us
        context.autopilot.begin(now_us)
        try:
            application.on_timer(now_us)
            status = application.status()
        except Exception as error:
            raise failure(self._title, error) from error
        if status is not self.status:
            self.status = self._checked(status)
        mavlink = context.autopilot.take(now_us)
        mavlink += self._report(now_us)
        radio = context.radio.take()
        return OnboardOutput(mavlink, radio) if mavlink or radio else NOTHING

    def estimate(self, now_us: int) -> Estimate:
        """Return the application's position estimate."""
        return self._call(self.application.estimate, now_us)

    def troubles(self) -> Mapping[str, int]:
        """Return counts of the faults that were handled."""
        return self._call(self.application.troubles)

    def _report(self, now_us: int) -> list[Message]:
        """Return the messages with the status that are due."""
        status, messages = self.status, []
        reported = (int(status.phase), status.motion_start_us)
        if reported != self._reported or now_us >= self._heartbeat_us:
            self._reported = reported
            self._heartbeat_us = now_us + HEARTBEAT_PERIOD_US
            messages.append(_heartbeat(status))
            if status.motion_start_us is not None:
                start_ms = status.motion_start_us // 1_000
                messages.append(common.MAVLink_named_value_int_message(now_us // 1_000, START_NAME, start_ms))
        if self._reports.values and now_us >= self._values_us:
            self._values_us = now_us + VALUES_PERIOD_US
            values = (*self.values, *[0.0] * (58 - len(self._reports.values)))
            messages.append(common.MAVLink_debug_float_array_message(now_us, VALUES_NAME, 0, values))
        if status.text and status.text != self._text:
            messages.append(_text(common.MAV_SEVERITY_INFO, status.text))
        self._text = status.text
        messages += [_text(common.MAV_SEVERITY_WARNING, text) for text in self._context.take_warnings()]
        return messages

    def _checked(self, status: Status) -> Status:
        """Return a status whose phase and numbers are declared. Raises ExtensionFailure."""
        reports = self._reports
        if not isinstance(status, Status):
            raise self._refused(f"status returned a {type(status).__name__}; expected a Status")
        if not isinstance(status.phase, reports.phases):
            raise self._refused(
                f"status has the phase {status.phase!r}; expected a member of {reports.phases.__name__}"
            )
        unknown = sorted(set(status.values) - set(reports.values))
        if unknown:
            names = ", ".join(reports.values) or "none"
            raise self._refused(f"status has a number {unknown[0]!r}; its reports declare {names}")
        return status

    def _refused(self, what: str) -> ExtensionFailure:
        return ExtensionFailure(f"{self._title}: {what}")

    def _call(self, method: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Call a method of the application. Raises ExtensionFailure."""
        try:
            return method(*args, **kwargs)
        except Exception as error:
            raise failure(self._title, error) from error


def _heartbeat(status: Status) -> Message:
    return common.MAVLink_heartbeat_message(
        common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, int(status.phase),
        common.MAV_STATE_ACTIVE, 3,
    )  # fmt: skip


def _text(severity: int, text: str) -> Message:
    return common.MAVLink_statustext_message(severity, text.encode("ascii", "replace"))

"""One application with its context: calls its methods and checks what they return. No I/O.

An exception of the application, or a wrong value that it returns, is raised as ExtensionFailure.
"""

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from autopilot.mavlink.codec import Message
from autopilot.onboard.application import (
    MOST_TEXT,
    MOST_VALUES,
    Application,
    Estimate,
    Layout,
    Reports,
    Status,
)
from autopilot.onboard.client.autopilot_client import check_message
from autopilot.onboard.context import Context
from foundation.extension_call import ExtensionCall
from netsim.wire.messages import RxItem


class Program:
    """An application that has been started.

    ``title`` begins the lines of its failures, such as ``onboard.application my_package.app:App``.
    """

    def __init__(self, application: Application, context: Context, *, title: str, name: str = "") -> None:
        self.application = application
        self.context = context
        self.name = name
        """Empty for the application that flies the UAV; others have names."""
        self._call = ExtensionCall(title)
        self._reports = application.reports
        with self._call:
            application.start(context)
            status = application.status()
        self._returned = status
        self.status = self._checked(status)
        """Status after the last iteration; its numbers are a copy."""

    @property
    def title(self) -> str:
        """Beginning of its failures."""
        return self._call.title

    @property
    def values(self) -> Mapping[str, float]:
        """The numbers of the status by their names in the UAV's `Layout`."""
        values = self.status.values
        if not self.name:
            return values
        phase = {f"{self.name}_phase": float(self.status.phase)} if _has_phase_value(self._reports) else {}
        return phase | {f"{self.name}_{name}": value for name, value in values.items()}

    def on_mavlink(self, message: Message, now_us: int) -> None:
        """Process a message of the autopilot."""
        with self._call:
            self.application.on_mavlink(message, now_us)

    def on_request(self, message: Message) -> Sequence[Message]:
        """Return the answers to a message that a station addressed to the UAV's applications."""
        with self._call:
            answers = list(self.application.on_request(message))
            for answer in answers:
                check_message(answer)
        return answers

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:
        """Process what the radio received and measured."""
        with self._call:
            self.application.on_radio(items, now_us)

    def on_timer(self, now_us: int) -> None:
        """Run one iteration; `status` is then the new one."""
        application = self.application
        with self._call:
            application.on_timer(now_us)
            status = application.status()
        if status is not self._returned or status.values:
            self._returned = status
            self.status = self._checked(status)

    def estimate(self, now_us: int) -> Estimate:
        """Return the application's position estimate."""
        with self._call:
            estimate = self.application.estimate(now_us)
        if not isinstance(estimate, Estimate):
            raise self._call.refused(f"estimate returned a {type(estimate).__name__}; expected an Estimate")
        return estimate

    def troubles(self) -> Mapping[str, int]:
        """Return counts of the faults that were handled."""
        with self._call:
            return {str(name): int(count) for name, count in self.application.troubles().items()}

    def _checked(self, status: Status) -> Status:
        """Return a status, with a copy of its numbers, if all is as declared. Raises ExtensionFailure."""
        reports = self._reports
        if not isinstance(status, Status):
            raise self._call.refused(f"status returned a {type(status).__name__}; expected a Status")
        if not isinstance(status.phase, reports.phases):
            raise self._call.refused(
                f"status has the phase {status.phase!r}; expected a member of {reports.phases.__name__}"
            )
        text: object = status.text
        if not (isinstance(text, str) and text.isascii() and len(text) <= MOST_TEXT):
            raise self._call.refused(
                f"status has the text {text!r:.100}; expected at most {MOST_TEXT} ASCII characters"
            )
        given: object = status.values
        if not isinstance(given, Mapping):
            raise self._call.refused(f"status has {given!r:.100} as values; expected numbers by name")
        values: dict[str, float] = {}
        for name, value in given.items():
            if name not in reports.values:
                names = ", ".join(reports.values) or "none"
                raise self._call.refused(f"status has a number {name!r}; its reports declare {names}")
            try:
                values[name] = float(value)
            except (TypeError, ValueError):
                raise self._call.refused(f"status has {value!r:.100} as {name}; expected a number") from None
        return msgspec.structs.replace(status, values=values) if values else status


def layout(first: Reports, others: Mapping[str, Reports]) -> Layout:
    """Return the layout of a UAV's programs: the application that flies it, and the others by their names.

    Numbers of others begin with the program's name; the phase is one of them, unless there is only one.
    Raises ValueError for too many numbers, and for names that occur twice.
    """
    values = [*first.values]
    for name, reports in others.items():
        values += [f"{name}_phase"] if _has_phase_value(reports) else []
        values += [f"{name}_{value}" for value in reports.values]
    if len(values) > MOST_VALUES:
        raise ValueError(f"{len(values)} numbers of all programs; expected at most {MOST_VALUES}")
    twice = sorted({value for value in values if values.count(value) > 1})
    if twice:
        raise ValueError(f"the number {twice[0]} of two programs; expected other names")
    return msgspec.structs.replace(first.layout(), values=tuple(values))


def _has_phase_value(reports: Reports) -> bool:
    return len(reports.phases) > 1

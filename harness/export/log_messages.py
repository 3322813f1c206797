"""Events of a run, and changes of the vehicles' states, as messages of a log."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.application import Layout
from harness.export.json_rows import DIALECT, Schema
from harness.export.messages import Content, Message, Topic, frame_of, timestamp
from harness.export.vehicle_messages import names_of_bits, value_names
from harness.records.columns import flight_kind
from harness.records.event_words import Level, in_words
from harness.records.pieces import Event

EVENTS, LOG = "/events", "/log"
INFO, WARNING, ERROR = 2, 3, 4
"""`Log.Level`"""
_LEVELS = {Level.INFO: INFO, Level.WARNING: WARNING, Level.ERROR: ERROR}
SWARM = "swarm"
_INTEGER, _STRING = {"type": "integer"}, {"type": "string"}
_FIELDS: Mapping[str, Schema] = {
    "event": _STRING | {"description": "Kind of the event."},
    "time_us": _INTEGER | {"description": "Simulated time. Unit: µs."},
    "instance": _INTEGER | {"description": "Number of the vehicle; missing: every vehicle, or none."},
    "text": _STRING | {"description": "Text of the status of an on-board application."},
    "reason": _STRING | {"description": "Why a vehicle or application is lost."},
    "start_us": _INTEGER | {"description": "Start of the formation's motion. Unit: µs."},
    "first": _INTEGER | {"description": "One of two vehicles that touch."},
    "second": _INTEGER | {"description": "The other of them."},
    "pos_ned_m": {
        "type": "array", "items": {"type": "number"},
        "description": "Position where they touch. Unit: m. Frame: NED.",
    },
    "number": _INTEGER | {"description": "Number of a fault, as in the scenario, from 0."},
    "what": _STRING | {"description": "Kind of the fault."},
    "motor": _INTEGER | {"description": "Motor of the fault."},
    "change": _STRING | {"description": "`began` or `ended`."},
}  # fmt: skip
"""Fields of the events of `harness.simulator.messages` that are recorded."""


def event_topics() -> list[Topic]:
    """Return the topics of events and of the log."""
    schema = {
        "$schema": DIALECT,
        "title": "coflight.Event",
        "description": "An event of events.jsonl. What it does not have is missing.",
        "type": "object",
        "properties": dict(_FIELDS),
        "required": ["event", "time_us"],
    }
    return [
        Topic(
            name=EVENTS, schema="coflight.Event", json_schema=schema, description="A line of events.jsonl."
        ),
        Topic(
            name=LOG,
            schema="foxglove.Log",
            description="Events in words, and changes of mode, phase, arming and failsafes of each vehicle.",
        ),
    ]


class LogMessages:
    """Maps events and changes of state to messages; it holds the last state of each vehicle."""

    def __init__(self, applications: Layout, *, epoch_ns: int) -> None:
        self._names = value_names(flight_kind(applications))
        self._epoch_ns = epoch_ns
        self._last: list[dict[str, int] | None] = []

    def events(self, events: list[Event]) -> Iterator[Message]:
        """Yield the messages of events."""
        for event in events:
            time_ns = event["time_us"] * 1_000
            yield Message(
                time_ns, EVENTS, {name: value for name, value in event.items() if value is not None}
            )
            words = in_words(event)
            name = SWARM if words.vehicle is None else frame_of(words.vehicle)
            yield self._line(time_ns, _LEVELS[words.level], name, words.text)

    def changes(self, flight: NDArray[Any]) -> Iterator[Message]:
        """Yield the messages of changes between instants of (T, N) records."""
        self._last = self._last or [None] * flight.shape[1]
        for uav in range(flight.shape[1]):
            for row in _rows_with_changes(flight[:, uav]):
                now = {name: int(row[name]) for name in _WATCHED}
                before = self._last[uav]
                if before is not None:
                    for level, text in self._differences(before, now):
                        yield self._line(int(row["time_us"]) * 1_000, level, frame_of(uav), text)
                self._last[uav] = now

    def _differences(self, before: dict[str, int], now: dict[str, int]) -> Iterator[tuple[int, str]]:
        if now["armed"] != before["armed"]:
            yield INFO, "armed" if now["armed"] else "disarmed"
        for name in ("mode", "phase"):
            if now[name] != before[name]:
                yield INFO, f"{name} {self._names[name].get(now[name], now[name])}"
        if now["failsafe"] != before["failsafe"]:
            yield (WARNING, "failsafe begins") if now["failsafe"] else (INFO, "failsafe ends")
        if new := now["causes"] & ~before["causes"]:
            yield WARNING, f"cause of a failsafe: {names_of_bits(new, self._names['causes'])}"
        if gone := before["causes"] & ~now["causes"]:
            yield INFO, f"cause of a failsafe is gone: {names_of_bits(gone, self._names['causes'])}"

    def _line(self, time_ns: int, level: int, name: str, text: str) -> Message:
        content: Content = {
            "timestamp": timestamp(self._epoch_ns + time_ns),
            "level": level,
            "message": text,
            "name": name,
        }
        return Message(time_ns, LOG, content)


_WATCHED = ("armed", "mode", "phase", "failsafe", "causes")


def _rows_with_changes(rows: NDArray[Any]) -> NDArray[Any]:
    """Return the first row and those that differ from the row before in what is watched."""
    changed = np.ones(len(rows), dtype=np.bool_)
    changed[1:] = np.any([rows[name][1:] != rows[name][:-1] for name in _WATCHED], axis=0)
    return rows[changed]

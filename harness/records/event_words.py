"""The events of a run in words: for viewers, exports and pages."""

from collections.abc import Mapping
from enum import Enum
from typing import Any, NamedTuple


class Level(Enum):
    """How grave an event is."""

    INFO = "INFO"
    WARNING = "WARN"
    ERROR = "ERROR"


class EventWords(NamedTuple):
    """An event in words."""

    level: Level
    vehicle: int | None
    """None: of the whole run"""
    text: str
    """Without the vehicle"""


def in_words(event: Mapping[str, Any]) -> EventWords:
    """Return an event of ``events.jsonl`` in words."""
    vehicle = event.get("instance")
    match event["event"]:
        case "formed":
            return EventWords(Level.INFO, vehicle, "formation reached")
        case "formationmoves":
            return EventWords(Level.INFO, vehicle, f"formation moves from {event['start_us'] / 1e6:.3f} s on")
        case "applicationtext":
            return EventWords(Level.INFO, vehicle, f"application: {event['text']}")
        case "vehiclelost":
            return EventWords(Level.ERROR, vehicle, f"lost: {event['reason']}")
        case "applicationlost":
            return EventWords(Level.ERROR, vehicle, f"application lost: {event['reason']}")
        case "collision":
            return EventWords(Level.ERROR, event["first"], f"touches UAV {event['second']}")
        case "faultchanged":
            motor = "" if event.get("motor") is None else f" {event['motor']}"
            text = f"fault {event['number']} ({event['what']}{motor}) {event['change']}"
            return EventWords(Level.WARNING, vehicle, text)
        case kind:
            rest = {key: value for key, value in event.items() if key not in ("event", "time_us", "instance")}
            text = f"{kind} {', '.join(f'{key} = {value}' for key, value in rest.items())}".strip()
            return EventWords(Level.INFO, vehicle, text)

"""What the file consists of: topics with their schemas, and messages as plain data.

The content of a message is a dict in the form of its schema. That of one of Foxglove's schemas has the names
of its fields, with vectors as dicts; `harness.export.mcap_file` encodes it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from foundation.types import Array

Content = dict[str, Any]
SITE = "site"
"""Frame of the site: ENU from its origin."""
IDENTITY: Mapping[str, float] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the file."""

    name: str
    schema: str
    """Full name of the schema: ``foxglove.``... for Foxglove's, ``coflight.``... for a JSON schema."""
    json_schema: Mapping[str, Any] | None = None
    """None for one of Foxglove's."""
    description: str
    """What a message is, and when there is one."""


class Message(NamedTuple):
    """A message."""

    time_ns: int
    """Simulated time since the start."""
    topic: str
    content: Content


def frame_of(uav: int) -> str:
    """Return the name of a vehicle's frame: FLU at its true centre of mass."""
    return f"uav{uav}"


def believed_frame_of(uav: int) -> str:
    """Return the name of the frame at the position and attitude that a vehicle estimates."""
    return f"uav{uav}_believed"


def timestamp(unix_ns: int) -> Content:
    """Return a date, in ns of UNIX time, as Foxglove's schemas have it."""
    return {"seconds": unix_ns // 1_000_000_000, "nanos": unix_ns % 1_000_000_000}


def vectors(values: Array) -> list[Content]:
    """Return vectors (n, 3) as x, y and z."""
    return [{"x": x, "y": y, "z": z} for x, y, z in values.tolist()]


def quaternions(q: Array) -> list[Content]:
    """Return rotations (n, 4), wxyz, as Foxglove's schemas have them."""
    return [{"x": x, "y": y, "z": z, "w": w} for w, x, y, z in q.tolist()]

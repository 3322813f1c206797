"""What a station is asked to send and how that ended, and what it receives."""

from collections.abc import Callable
from enum import StrEnum
from typing import Protocol

from msgspec import Struct

from netsim.mac.rates import RateControl
from netsim.phy.frames import FrameKind
from netsim.phy.modes import PhyMode


class JobOutcome(StrEnum):
    """How a job ended."""

    SENT = "sent"
    """A group-addressed frame went out."""
    ACKNOWLEDGED = "acknowledged"
    RETRY_LIMIT = "retry_limit"
    EXPIRED = "expired"
    """It outlived its time in the queue, tried or not, was taken back, or its radio fell silent."""
    OVERFLOW = "overflow"
    """The queue was full."""


class Reception(Struct, frozen=True):
    """A frame as one station has received it."""

    source: int
    start_ns: int
    """At the sender's antenna."""
    end_ns: int
    """At this one's."""
    power_mw: float
    seq: int = 0
    """The host's number of what it carries."""
    body: object = None
    duplicate: bool = False
    """The same has been received before."""


class GroupReception(Struct, frozen=True):
    """A datagram to all as those have received it who did: lists are by receiver."""

    source: int
    seq: int
    """The host's number of it."""
    body: object
    stations: list[int]
    ends_ns: list[int]
    """At their antennas."""
    powers_mw: list[float]


class Job(Struct, kw_only=True, eq=False):
    """One frame to be delivered, by as many transmissions as it takes."""

    kind: FrameKind
    destination: int
    mode: PhyMode
    rates: RateControl | None = None
    """Chooses ``mode`` anew before each attempt; None keeps it."""
    frame_bytes: int
    expires_ns: int
    retry_limit: int
    """Failed exchanges after which the next failure gives the frame up."""
    done: Callable[["Job", JobOutcome], None]
    seq: int = 0
    """The host's number of it."""
    body: object = None
    rts: bool = False
    """Reserve the medium first: with the destination, or for a group frame with a neighbour."""
    cancelled: bool = False
    attempts: int = 0
    """Transmissions of the frame itself; this and the rest is known when it has ended."""
    failures: int = 0
    sequence: int = 0
    sent_ns: int | None = None
    """When it last went on the air."""
    ack: Reception | None = None
    """The acknowledgement that ended it."""
    row: int | None = None
    """Where it is kept by who sends it."""


class FrameSender(Protocol):
    """One station's way to the air."""

    def enqueue(self, category: str, job: Job, /) -> None:
        """Take a frame for transmission in an access category; its job tells how that ends, at once too."""

    def cancel(self, job: Job, /) -> None:
        """Have a frame leave its queue instead of going out; harmless when it has ended."""

    def has_begun(self, job: Job, /) -> bool:
        """Whether a frame has gone out at least once."""

    def silence(self) -> None:
        """End for good: nothing is sent, answered or heard any more."""


class Upper(Protocol):
    """Who gets the frames that are for a station."""

    def on_frame(self, reception: Reception) -> None:
        """Take a data or action frame."""


OnGroupFrame = Callable[[GroupReception], None]
"""Takes a frame to all, for all who have received it."""

"""Interface of a station's MAC: jobs to send and their outcomes, received frames."""

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Protocol

from msgspec import Struct

from netsim.mac.rates import AdaptiveRate
from netsim.phy.frames import FrameKind
from netsim.phy.modes import PhyMode


class JobOutcome(StrEnum):
    """How a job ended."""

    SENT = "sent"
    """A group-addressed frame was sent."""
    ACKNOWLEDGED = "acknowledged"
    RETRY_LIMIT = "retry_limit"
    EXPIRED = "expired"
    """Its lifetime was over, it was cancelled, or its radio was switched off."""
    OVERFLOW = "overflow"
    """The queue was full."""


class Reception(Struct, frozen=True):
    """A frame received by one station."""

    source: int
    start_ns: int
    """Begin of the frame at the sender's antenna."""
    end_ns: int
    """End of the frame at this station's antenna."""
    power_mw: float
    seq: int = 0
    """The host's sequence number of the payload."""
    body: object = None
    duplicate: bool = False
    """The frame has been received before."""


class DatagramReception(Struct, frozen=True):
    """A received datagram; lists have one entry per receiver."""

    source: int
    seq: int
    """The host's sequence number."""
    body: object
    stations: Sequence[int]
    ends_ns: Sequence[int]
    """End of the frame at their antennas."""
    powers_mw: Sequence[float]


class Job(Struct, kw_only=True, eq=False):
    """One frame to be sent, with retransmissions."""

    kind: FrameKind
    destination: int
    mode: PhyMode
    rates: AdaptiveRate | None = None
    """Selects ``mode`` before each attempt; None: fixed mode."""
    frame_bytes: int
    expires_ns: int
    retry_limit: int
    """Failed exchanges after which the next failure drops the frame."""
    done: Callable[["Job", JobOutcome], None]
    seq: int = 0
    """The host's sequence number."""
    body: object = None
    rts: bool = False
    """Send RTS first: to the destination, or for a group frame to a neighbour."""
    deferred: bool = False
    """Report its end and its reception by the end of the simulated time span instead of at once, since no
    frame depends on them; its reception goes to `OnDatagram`."""
    repeats: bool = False
    """Append it to its queue again whenever it ends, without reports, while its radio is on; for deferred
    jobs."""
    cancelled: bool = False
    attempts: int = 0
    """Transmissions of the frame itself; this and the following fields are set at the end of the job."""
    failures: int = 0
    sequence: int = 0
    sent_ns: int | None = None
    """Time of the last transmission."""
    ack: Reception | None = None
    """The acknowledgement that ended the job; None for a deferred one."""
    ended_ns: int = 0
    """End of a deferred job: of its ACK, or of the group frame, or time at which it was dropped."""
    row: int | None = None
    """Row in the sender's table of jobs; None when it has none."""


class FrameSender(Protocol):
    """Sending side of one station's MAC."""

    def enqueue(self, category: str, job: Job, /) -> None:
        """Enqueue a frame in an access category; ``job.done`` reports its outcome, possibly at once."""

    def enqueue_at(self, at_ns: int, category: str, job: Job, /) -> None:
        """Enqueue a deferred job later, unless the radio is off then: that is not reported."""

    def cancel(self, job: Job, /) -> None:
        """Remove a frame from its queue before it is sent; no effect after its end."""

    def has_begun(self, job: Job, /) -> bool:
        """Whether a frame has been sent at least once."""

    def silence(self) -> None:
        """Switch the radio off for good: it no longer sends, responds or receives."""


class Upper(Protocol):
    """Layer above the MAC of a station."""

    def on_frame(self, reception: Reception) -> None:
        """Process the received frame of a job that is not deferred."""


OnDatagram = Callable[[DatagramReception], None]
"""Processes a group frame, or the frame of a deferred job, for all stations that have received it."""

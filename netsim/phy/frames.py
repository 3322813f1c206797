"""Frames and their sizes."""

from enum import StrEnum

from netsim.phy.modes import PhyMode

GROUP = -1
"""Destination of a group frame."""
RTS_BYTES = 20
CTS_BYTES = 14
ACK_BYTES = 14
DATA_OVERHEAD_BYTES = 24 + 4
"""MAC header and FCS of a data or action frame."""
UDP_OVERHEAD_BYTES = 8 + 20 + 8
"""LLC/SNAP, IPv4 and UDP headers."""
MAX_MSDU_BYTES = 2304
"""Largest frame body after the MAC header (9.2.4.7)."""


class FrameKind(StrEnum):
    """Kind of a frame."""

    DATA = "data"
    RTS = "rts"
    CTS = "cts"
    ACK = "ack"
    FTM_REQUEST = "ftm_request"
    FTM = "ftm"


class Frame:
    """One frame; immutable once sent."""

    __slots__ = (
        "body",
        "bytes",
        "destination",
        "duration_ns",
        "is_answer",
        "kind",
        "lapse_ns",
        "mode",
        "nav_ns",
        "seq",
        "sequence",
        "source",
    )

    def __init__(
        self,
        *,
        kind: FrameKind,
        source: int,
        destination: int,
        mode: PhyMode,
        frame_bytes: int,
        nav_ns: int = 0,
        lapse_ns: int = 0,
        seq: int = 0,
        sequence: int = 0,
        body: object = None,
    ) -> None:
        self.kind = kind
        self.is_answer = kind is FrameKind.ACK or kind is FrameKind.CTS
        self.source = source
        self.destination = destination
        self.mode = mode
        self.bytes = frame_bytes
        self.duration_ns = mode.duration_ns(frame_bytes)
        self.nav_ns = nav_ns
        """Duration field: time for which the medium is reserved after this frame."""
        self.lapse_ns = lapse_ns
        """Time after this frame at which the NAV is reset where no frame was detected since; 0: never."""
        self.seq = seq
        """The host's sequence number of the payload."""
        self.sequence = sequence
        """MAC sequence number; a retransmission has that of the first transmission."""
        self.body = body

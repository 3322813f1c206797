"""Frames as the air carries them, and their sizes."""

from enum import StrEnum

from netsim.phy.modes import PhyMode

GROUP = -1
"""Destination of a frame to everybody."""
RTS_BYTES = 20
CTS_BYTES = 14
ACK_BYTES = 14
DATA_OVERHEAD_BYTES = 24 + 4
"""MAC header and FCS of a data or action frame."""
UDP_OVERHEAD_BYTES = 8 + 20 + 8
"""LLC/SNAP, IPv4 and UDP headers."""
MAX_MSDU_BYTES = 2304
"""Most that one frame carries behind its MAC header (9.2.4.7)."""


class FrameKind(StrEnum):
    """What a frame is for."""

    DATA = "data"
    RTS = "rts"
    CTS = "cts"
    ACK = "ack"
    FTM_REQUEST = "ftm_request"
    FTM = "ftm"


class Frame:
    """One frame, ready for the air; never changed once sent."""

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
        """Duration field: how long the medium stays reserved after this frame."""
        self.lapse_ns = lapse_ns
        """Time after this frame at which the reservation falls where nothing was heard since; 0 is never."""
        self.seq = seq
        """The host's number of what it carries."""
        self.sequence = sequence
        """The MAC's sequence number: that of a retransmission is the first one's."""
        self.body = body

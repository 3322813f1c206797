"""Frames, their sizes, and their transmissions."""

from enum import StrEnum
from typing import NamedTuple

from msgspec import Struct

from netsim.model.tables import Integers
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles
from netsim.phy.receptions import ERRORS, RECEIVED, Receptions

GROUP = -1
"""Destination of a group frame."""
RTS_BYTES = 20
CTS_BYTES = 14
ACK_BYTES = 14
DATA_OVERHEAD_BYTES = 24 + 4
"""MAC header and FCS of a data or action frame."""
SNAP_OVERHEAD_BYTES = 8
"""LLC/SNAP header."""
UDP_OVERHEAD_BYTES = SNAP_OVERHEAD_BYTES + 20 + 8
"""LLC/SNAP, IPv4 and UDP headers."""
MAX_MSDU_BYTES = 2304
"""Largest frame body after the MAC header (9.2.4.7)."""


class Datagram(NamedTuple):
    """Body of a data frame."""

    port: int
    """UDP port, source and destination."""
    payload: bytes


class Packet(NamedTuple):
    """Body of a data frame: the payload of an Ethernet frame, of any protocol."""

    destination: bytes
    """MAC address of 6 bytes: a group's, or that of the frame's destination."""
    ether_type: int
    payload: bytes


class FrameKind(StrEnum):
    """Kind of a frame."""

    DATA = "data"
    RTS = "rts"
    CTS = "cts"
    ACK = "ack"
    FTM_REQUEST = "ftm_request"
    FTM = "ftm"


KINDS = list(FrameKind)
"""Frame kinds in the order of `netsim.model.codes`."""


class Frame(Struct, frozen=True, kw_only=True):
    """One frame."""

    kind: FrameKind
    source: int
    destination: int
    mode: PhyMode
    frame_bytes: int
    """Length including MAC header and FCS."""
    nav_ns: int = 0
    """Duration field: time for which the medium is reserved after this frame."""
    seq: int = 0
    """The host's sequence number of the payload."""
    sequence: int = 0
    """MAC sequence number; a retransmission has that of the first transmission."""
    body: object = None


class Transmission(Struct):
    """A frame that is or was on the air, and its outcome, for observers of the whole channel."""

    frame: Frame
    start_ns: int
    powers_mw: Doubles
    """Received powers by station; delays are also by station."""
    delays_ns: Integers
    longest_delay_ns: int
    """Longest delay to a station that can sense the frame."""
    delivered: list[int] = []
    """Intended receivers that received it."""
    collided: list[int] = []
    """Intended receivers that would have received it without other signals."""
    lost_to_noise: list[int] = []
    receptions: Receptions | None = None
    """At all stations, with ``RadioConfig.reports_receptions``."""

    @property
    def received(self) -> list[int]:
        """All stations that received it, addressed or not; none without `receptions`."""
        return self._stations_in(RECEIVED)

    @property
    def received_in_error(self) -> list[int]:
        """All stations that were locked on to it at its end and received errors, addressed or not."""
        return self._stations_in(ERRORS)

    def _stations_in(self, state: int) -> list[int]:
        if self.receptions is None:
            return []
        stations = (self.receptions.states == state).nonzero()[0].tolist()
        return [station for station in stations if station != self.frame.source]

    @property
    def source(self) -> int:
        """The transmitter's station."""
        return self.frame.source

    @property
    def end_ns(self) -> int:
        """Time at which it ends at the transmitter's antenna."""
        return self.start_ns + self.frame.mode.duration_ns(self.frame.frame_bytes)

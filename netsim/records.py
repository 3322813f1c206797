"""What the emulator remembers for logs and summaries: frames, ranging sessions, counts."""

from typing import NamedTuple

from msgspec import Struct


class FrameRecord(NamedTuple):
    """One transmission; the fields of `netsim.logs.FRAME_LOG` in their order."""

    start_ns: int
    end_ns: int
    """At the transmitter's antenna."""
    source: int
    destination: int
    """-1 for a group frame."""
    kind: str
    mode: str
    bytes: int
    """With MAC header and FCS."""
    seq: int
    """Of the item or session it belongs to; dialog token of a measurement frame; 0 for RTS, CTS and ACK."""
    delivered: int
    """Intended receivers that got it."""
    collided: int
    """Intended receivers that would have got it had nothing else been on the air."""
    lost_to_noise: int


class SessionRecord(NamedTuple):
    """One ranging request and its end; the fields of `netsim.logs.SESSION_LOG` in their order."""

    measured_ns: int
    initiator: int
    peer: int
    status: str
    distance_m: float
    true_distance_m: float
    """Mean over the round trips, at the end if there were none; 0.0 if there is no such peer."""
    distance_std_m: float
    round_trips: int
    rssi_dbm: float


class FtmCounters(Struct, frozen=True, kw_only=True):
    """Ranging requests since the start."""

    requested: int
    completed: int
    failed: dict[str, int]
    """By status."""
    error_sum_m: float
    """Sum over the completed of measured less true distance."""
    error_square_sum_m2: float


class Counters(Struct, frozen=True, kw_only=True):
    """Counts since the start."""

    frames_sent: dict[str, int]
    """By kind; every transmission counts, repeated ones too."""
    broadcasts_delivered: tuple[int, ...]
    """Broadcast datagrams that each station received, indexed by receiver."""
    broadcasts_collided: tuple[int, ...]
    """Those it would have received had nothing else been on the air."""
    broadcasts_lost_to_noise: tuple[int, ...]
    drops: dict[str, int]
    """Broadcast datagrams that were never sent, by reason."""
    ftm: FtmCounters

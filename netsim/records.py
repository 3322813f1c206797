"""What the emulator remembers for logs and summaries: frames, ranging sessions, counts."""

from collections import Counter
from typing import NamedTuple

from msgspec import Struct

from netsim.frames import GROUP, FrameKind
from netsim.ftm.session import Ranging
from netsim.phy.medium import Transmission


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
    unicasts: dict[str, int]
    """Datagrams to one station, by what became of them."""
    lost_by_hosts: int
    """Datagrams that stations received and their hosts lost."""
    ftm: FtmCounters


class Tally:
    """Keeps count while the emulator runs, and the records until somebody takes them."""

    def __init__(self, stations: int) -> None:
        self.ftm_requested = 0
        self.lost_by_hosts = 0
        self.drops: Counter[str] = Counter()
        self.unicasts: Counter[str] = Counter()
        self._frames: list[FrameRecord] = []
        self._sessions: list[SessionRecord] = []
        self._sent = dict.fromkeys(FrameKind, 0)
        self._delivered = [0] * stations
        self._collided = [0] * stations
        self._lost = [0] * stations
        self._ftm_ended: Counter[str] = Counter()
        self._error_sum_m = 0.0
        self._error_square_sum_m2 = 0.0

    def count_frame(self, transmission: Transmission) -> None:
        """Remember a transmission that has ended at all its receivers."""
        frame = transmission.frame
        kind, destination = frame.kind, frame.destination
        delivered, collided, lost = (
            transmission.delivered,
            transmission.collided,
            transmission.lost_to_noise,
        )
        self._sent[kind] += 1
        if kind is FrameKind.DATA and destination == GROUP:
            for counts, receivers in (
                (self._delivered, delivered),
                (self._collided, collided),
                (self._lost, lost),
            ):
                for receiver in receivers:
                    counts[receiver] += 1
        self._frames.append(
            FrameRecord(
                transmission.start_ns,
                transmission.end_ns,
                frame.source,
                destination,
                kind,
                frame.mode.name,
                frame.bytes,
                frame.seq,
                len(delivered),
                len(collided),
                len(lost),
            )
        )

    def count_session(self, ranging: Ranging) -> None:
        """Remember a ranging request that has ended."""
        self._ftm_ended[ranging.status] += 1
        if ranging.status == "ok":
            error_m = ranging.distance_m - ranging.true_distance_m
            self._error_sum_m += error_m
            self._error_square_sum_m2 += error_m * error_m
        self._sessions.append(
            SessionRecord(
                measured_ns=ranging.measured_ns,
                initiator=ranging.initiator,
                peer=ranging.peer,
                status=ranging.status,
                distance_m=ranging.distance_m,
                true_distance_m=ranging.true_distance_m,
                distance_std_m=ranging.distance_std_m,
                round_trips=ranging.round_trips,
                rssi_dbm=ranging.rssi_dbm,
            )
        )

    @property
    def counters(self) -> Counters:
        """Counts since the start."""
        return Counters(
            frames_sent={kind.value: self._sent[kind] for kind in FrameKind},
            broadcasts_delivered=tuple(self._delivered),
            broadcasts_collided=tuple(self._collided),
            broadcasts_lost_to_noise=tuple(self._lost),
            drops=dict(sorted(self.drops.items())),
            unicasts=dict(sorted(self.unicasts.items())),
            lost_by_hosts=self.lost_by_hosts,
            ftm=FtmCounters(
                requested=self.ftm_requested,
                completed=self._ftm_ended["ok"],
                failed={status: count for status, count in sorted(self._ftm_ended.items()) if status != "ok"},
                error_sum_m=self._error_sum_m,
                error_square_sum_m2=self._error_square_sum_m2,
            ),
        )

    def take_frames(self) -> list[FrameRecord]:
        """Transmissions that ended since the last call, in order of their end."""
        frames, self._frames = self._frames, []
        return frames

    def take_sessions(self) -> list[SessionRecord]:
        """Ranging sessions that ended since the last call, in order of their end."""
        sessions, self._sessions = self._sessions, []
        return sessions

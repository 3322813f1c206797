"""Records for logs and summaries: frames, ranging sessions, counters."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from netsim.emulator.log_layout import FRAME_LOG, RECEPTION_LOG
from netsim.ftm.initiator import Ranging
from netsim.model.tables import Integers
from netsim.phy.frames import KINDS, Transmission
from netsim.phy.modes import MODE_NAMES
from netsim.uwb.exchanges import UwbCounters


class FrameRecord(NamedTuple):
    """One transmission; the fields and their order are those of `netsim.emulator.log_layout.FRAME_LOG`."""

    start_ns: int
    end_ns: int
    """At the transmitter's antenna."""
    source: int
    destination: int
    """-1 for a group frame."""
    kind: str
    mode: str
    bytes: int
    """Length including MAC header and FCS."""
    seq: int
    """Sequence number of the item or request; for a measurement frame its number in the session, from 1; for
    a packet, a rejection, RTS, CTS and ACK 0."""
    delivered: int
    """Intended receivers that received it."""
    collided: int
    """Intended receivers that would have received it without other transmissions."""
    lost_to_noise: int


_KIND, _MODE = FrameRecord._fields.index("kind"), FrameRecord._fields.index("mode")


class FtmCounters(Struct, frozen=True, kw_only=True):
    """Counters of ranging requests since the start of the run."""

    requested: int
    completed: int
    failed: dict[str, int]
    """By status."""
    error_sum_m: float
    """Sum of measured minus true distance over completed requests."""
    error_square_sum_m2: float


class PacketCounters(Struct, frozen=True, kw_only=True):
    """Counters of network interfaces' packets since the start of the run."""

    outcomes: dict[str, int]
    """Packets that have left the queues, by outcome: of `netsim.mac.jobs.JobOutcome`, or
    ``unknown_destination``."""
    delivered: int
    """Receptions, of a group packet one per receiver."""
    lost_by_hosts: int
    """Receptions that the receivers' hosts have lost."""


class EmulatorCounters(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Counters since the start of the run."""

    frames_sent: dict[str, int]
    """Transmissions by kind, retransmissions included."""
    broadcasts_delivered: tuple[int, ...]
    """Broadcast datagrams and group packets received, indexed by receiver."""
    broadcasts_collided: tuple[int, ...]
    """Those that would have been received without other transmissions."""
    broadcasts_lost_to_noise: tuple[int, ...]
    drops: dict[str, int]
    """Broadcast datagrams dropped before transmission, by reason."""
    unicasts: dict[str, int]
    """Unicast datagrams by outcome."""
    lost_by_hosts: int
    """Datagrams that the radio received and the host lost."""
    ftm: FtmCounters
    packets: PacketCounters | None = None
    """None, and omitted when encoded, in a run without packets."""
    uwb: UwbCounters | None = None
    """None, and omitted when encoded, in a run without UWB radios."""


_KIND_BYTES = np.array([kind.value for kind in KINDS], "S16")
_MODE_BYTES = np.array(MODE_NAMES, "S16")


def frame_log_rows(frames: Integers) -> NDArray[np.void]:
    """Return `FRAME_LOG` rows for frame rows of a channel's `take_frames`."""
    rows = np.empty(len(frames), FRAME_LOG)
    for column, field in enumerate(FrameRecord._fields):
        rows[field] = frames[:, column]
    rows["kind"], rows["mode"] = _KIND_BYTES[frames[:, _KIND]], _MODE_BYTES[frames[:, _MODE]]
    return rows


def reception_log_rows(number: int, transmission: Transmission) -> NDArray[np.void]:
    """Return `RECEPTION_LOG` rows of a frame by receiver, none without `Transmission.receptions`.

    ``number`` is the frame's number since the start of the run.
    """
    receptions = transmission.receptions
    if receptions is None:
        return np.empty(0, RECEPTION_LOG)
    rows = np.empty(len(transmission.powers_mw), RECEPTION_LOG)
    rows["frame"], rows["start_ns"], rows["source"] = number, transmission.start_ns, transmission.source
    rows["receiver"] = np.arange(len(rows))
    with np.errstate(divide="ignore"):  # no power beyond the range limit: -inf
        rows["rx_power_dbm"] = 10.0 * np.log10(transmission.powers_mw)
        rows["sinr_db"] = 10.0 * np.log10(receptions.sinr)
    rows["outcome"], rows["reception"] = receptions.outcomes, receptions.states
    return np.delete(rows, transmission.source)


def frame_records(frames: Integers) -> list[FrameRecord]:
    """Return records for frame rows of a channel's `take_frames`."""
    rows = frames.tolist()
    for row in rows:
        row[_KIND], row[_MODE] = KINDS[row[_KIND]], MODE_NAMES[row[_MODE]]
    return [FrameRecord._make(row) for row in rows]


class Tally:
    """Counters above the channel, and the ended ranging sessions until `take_sessions`."""

    def __init__(self) -> None:
        self.ftm_requested = 0
        self.lost_by_hosts = 0
        self.drops: Counter[str] = Counter()
        self.unicasts: Counter[str] = Counter()
        self._sessions: list[Ranging] = []
        self._ftm_ended: Counter[str] = Counter()
        self._error_sum_m = 0.0
        self._error_square_sum_m2 = 0.0

    def count_session(self, ranging: Ranging) -> None:
        """Record a ranging request that has ended."""
        self._ftm_ended[ranging.status] += 1
        if ranging.status == "ok":
            error_m = ranging.distance_m - ranging.true_distance_m
            self._error_sum_m += error_m
            self._error_square_sum_m2 += error_m * error_m
        self._sessions.append(ranging)

    def counters(
        self, frames_sent: list[int], broadcasts: Integers, packets: PacketCounters | None,
        uwb: UwbCounters | None,
    ) -> EmulatorCounters:  # fmt: skip
        """Return all counters; a channel supplies its frames by kind and its group data frames (n, 3)."""
        delivered, collided, lost = (tuple(column) for column in broadcasts.T.tolist())
        return EmulatorCounters(
            frames_sent=dict(zip((kind.value for kind in KINDS), frames_sent, strict=True)),
            broadcasts_delivered=delivered,
            broadcasts_collided=collided,
            broadcasts_lost_to_noise=lost,
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
            packets=packets,
            uwb=uwb,
        )

    def take_sessions(self) -> list[Ranging]:
        """Return the ranging sessions that ended since the last call, in order of their end."""
        sessions, self._sessions = self._sessions, []
        return sessions

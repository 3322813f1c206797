"""Frames on the UWB channel: which of them a receiver gets among noise and overlapping frames.

Radios send without carrier sense, as UWB receivers do not detect frames after their preamble. A radio that
sends receives nothing. Of overlapping frames a receiver gets one whose power exceeds the sum of the others by
the capture ratio, in whatever order they arrive.
"""

from enum import Enum

from msgspec import Struct

from netsim.model.random_streams import FloatStream
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, Doubles
from netsim.phy.propagation import Trajectories
from netsim.uwb.config import UwbConfig
from netsim.uwb.link_budget import LinkBudget
from netsim.uwb.reception import packet_error_probability

NS_PER_M = 1e9 / SPEED_OF_LIGHT_M_S
LONGEST_WAY_NS = 100_000
"""Longest propagation delay that is considered: 30 km."""


class Outcome(Enum):
    """What a receiver gets of a frame."""

    RECEIVED = "received"
    COLLIDED = "collided"
    """It would have been received without other frames."""
    LOST_TO_NOISE = "lost_to_noise"
    MISSED = "missed"
    """The receiver was occupied by another exchange, or off."""


class OnAir(Struct, frozen=True, eq=False):
    """A frame on the channel; times at the transmitter's antenna."""

    source: int
    begin_ns: int
    end_ns: int
    payload_bytes: int
    powers_mw: Doubles
    """By station, without blockage."""


class UwbMedium:
    """The channel of all ranging radios; ``draws`` are uniform floats by receiver."""

    def __init__(
        self, config: UwbConfig, links: LinkBudget, trajectories: Trajectories, draws: list[FloatStream]
    ) -> None:
        self._config = config
        self._links = links
        self._trajectories = trajectories
        self._draws = draws
        self._capture: float = 10.0 ** (config.capture_db / 10.0)
        self._frames: list[OnAir] = []
        self._longest_ns = 0

    def send(self, source: int, begin_ns: int, end_ns: int, payload_bytes: int) -> OnAir:
        """Begin a frame now, at ``begin_ns``; return it."""
        self._longest_ns = max(self._longest_ns, end_ns - begin_ns)
        oldest_ns = begin_ns - self._longest_ns - 2 * LONGEST_WAY_NS
        self._frames = [frame for frame in self._frames if frame.end_ns >= oldest_ns]
        powers_mw = self._links.clear_powers_mw(source, begin_ns)
        frame = OnAir(source, begin_ns, end_ns, payload_bytes, powers_mw)
        self._frames.append(frame)
        return frame

    def power_mw(self, frame: OnAir, receiver: int) -> float:
        """Return the power that a station receives of a frame."""
        clear_mw = float(frame.powers_mw[receiver])
        return clear_mw if self.is_clear(frame, receiver) else clear_mw * self._links.blocked_gain

    def is_clear(self, frame: OnAir, receiver: int) -> bool:
        """Whether a frame reaches a station on a line of sight."""
        return not self._links.is_blocked(frame.source, receiver, frame.begin_ns)

    def outcome(self, frame: OnAir, receiver: int) -> Outcome:
        """Return whether a station receives a frame, when its end has reached the station."""
        power_mw = self.power_mw(frame, receiver)
        if self._draws[receiver].draw() < packet_error_probability(
            self._config, frame.payload_bytes, power_mw
        ):
            return Outcome.LOST_TO_NOISE
        begin_ns, end_ns = self._span_ns(frame, receiver)
        others_mw = 0.0
        for other in self._frames:
            if other is frame:
                continue
            other_begin_ns, other_end_ns = self._span_ns(other, receiver)
            if other_begin_ns < end_ns and begin_ns < other_end_ns:
                if other.source == receiver:
                    return Outcome.COLLIDED
                others_mw += self.power_mw(other, receiver)
        return Outcome.RECEIVED if power_mw >= self._capture * others_mw else Outcome.COLLIDED

    def delay_ns(self, frame: OnAir, receiver: int) -> int:
        """Return the propagation delay of a frame, in whole nanoseconds."""
        way_m = self._trajectories.distance_m(frame.source, receiver, frame.begin_ns)
        return min(round(way_m * NS_PER_M), LONGEST_WAY_NS)

    def _span_ns(self, frame: OnAir, receiver: int) -> tuple[int, int]:
        delay_ns = self.delay_ns(frame, receiver) if frame.source != receiver else 0
        return frame.begin_ns + delay_ns, frame.end_ns + delay_ns

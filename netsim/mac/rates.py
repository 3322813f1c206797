"""Which mode a station sends its next frame in, learnt from what its neighbours acknowledge.

The method is that of minstrel, which Linux's mac80211 uses: success by mode and destination as a moving
average over intervals, the mode of best expected throughput first, and a regular share of frames in other
modes to learn of them. Two things differ: the average weighs attempts, not intervals, so that two samples do
not outvote two hundred frames; and a mode that keeps failing is sampled more and more rarely. Losses by
collision count as losses, for an acknowledgement that stays away says no more.
"""

from typing import Annotated, NamedTuple, Protocol, get_args

from msgspec import Meta, Struct

from netsim.model.config import BandwidthMhz, Mode, RadioConfig, StationConfig
from netsim.model.random_streams import Model, RandomStreams, Uniforms
from netsim.phy.frames import ACK_BYTES
from netsim.phy.modes import PhyMode, phy_mode, response_mode

OVERHEAD_NS = 34_000 + 67_500 + 16_000
"""Share of an exchange that no mode shortens: DIFS, the mean of the smallest backoff, SIFS."""
HOPELESS = 0.1
"""A mode that succeeds more rarely is not taken for its throughput."""
LONGEST_REST = 15
"""Sampling turns that a hopeless mode sits out at most."""
FAILURES_PER_STAGE = 2


class RateControl(Protocol):
    """Chooses the mode of each attempt of frames to one station, and learns how it ended."""

    def mode_for(self, destination: int, *, frame_bytes: int, failures: int, now_ns: int) -> PhyMode:
        """Mode of the next attempt of a frame that has failed ``failures`` times."""

    def report(self, destination: int, mode: PhyMode, *, acknowledged: bool) -> None:
        """Take how an attempt ended in which the frame itself was sent."""


class RateParameters(Struct, frozen=True, kw_only=True):
    """How fast it learns. The interval is minstrel's, whose memory is 0.75 and whose lookaround is 0.1."""

    interval_ns: Annotated[int, Meta(ge=1_000_000)] = 100_000_000
    """Between two updates of the averages."""
    memory: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.9
    """Weight that an attempt keeps from one update to the next."""
    most_evidence: Annotated[float, Meta(ge=1.0)] = 300.0
    """Weight of all attempts together, at most: how soon a mode in use is known to have changed."""
    lookaround_ratio: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    """Share of frames that may be sent in another mode to learn of it."""


def channel_modes(bandwidth_mhz: BandwidthMhz, *, vht: bool) -> tuple[PhyMode, ...]:
    """All modes of a channel's width in order of rate, VHT or non-HT ones."""
    names: list[Mode] = [name for name in get_args(Mode) if name.startswith("vht") is vht]
    if bandwidth_mhz == 20 and vht:
        names.remove("vht_mcs9")
    return tuple(phy_mode(name, bandwidth_mhz) for name in names)


class _Mode:
    """What is known of one mode to one destination."""

    __slots__ = ("attempts", "evidence", "mode", "rest", "skips", "success", "successes", "time_ns")

    def __init__(self, mode: PhyMode) -> None:
        self.mode = mode
        self.attempts = 0
        self.successes = 0
        """Both since the last update."""
        self.success: float | None = None
        """Average probability; None before the first attempt."""
        self.evidence = 0.0
        """Attempts in that average, the older the less."""
        self.time_ns = 1
        """Of an exchange that succeeds at once."""
        self.skips = 0
        self.rest = 0
        """Sampling turns left to sit out, and how many it was sentenced to."""

    def throughput(self) -> float:
        """Expected frames per nanosecond."""
        success = self.success
        return success / self.time_ns if success is not None and success >= HOPELESS else 0.0

    def update(self, memory: float, most_evidence: float) -> None:
        self.evidence *= memory
        if not self.attempts:
            return
        kept = (self.success or 0.0) * self.evidence
        self.evidence += self.attempts
        self.success = (kept + self.successes) / self.evidence
        self.evidence = min(self.evidence, most_evidence)
        if self.success < HOPELESS:
            self.rest = min(2 * self.rest + 1, LONGEST_REST)
            self.skips = self.rest
        else:
            self.rest = self.skips = 0
        self.attempts = self.successes = 0


class _Destination:
    """What is known of one destination."""

    __slots__ = ("by_name", "chain", "frames", "modes", "sample", "samples", "turn", "turns", "update_ns")

    def __init__(self, modes: tuple[PhyMode, ...]) -> None:
        self.modes = [_Mode(mode) for mode in modes]
        self.by_name = {each.mode.name: each for each in self.modes}
        self.chain = [self.modes[0]] * 4
        """Modes of the stages of a frame: best throughput, second best, most probable, lowest."""
        self.update_ns = 0
        self.frames = 0
        self.samples = 0.0
        self.sample: _Mode | None = None
        """To be tried with the first repetition."""
        self.turns: list[_Mode] = []
        self.turn = 0


class AdaptiveRate:
    """Rate control of one station."""

    def __init__(
        self,
        modes: tuple[PhyMode, ...],
        uniforms: Uniforms,
        parameters: RateParameters | None = None,
    ) -> None:
        """Choose among ``modes``, of which the first is the most robust. ``uniforms`` orders the samples."""
        self._modes = modes
        self._uniforms = uniforms
        self._parameters = parameters or RateParameters()
        self._destinations: dict[int, _Destination] = {}

    def mode_for(self, destination: int, *, frame_bytes: int, failures: int, now_ns: int) -> PhyMode:
        """See `RateControl`."""
        known = self._destinations.get(destination)
        if known is None:
            known = self._destinations[destination] = _Destination(self._modes)
        if now_ns >= known.update_ns:
            self._update(known, frame_bytes)
            known.update_ns = now_ns + self._parameters.interval_ns
        if failures == 0:
            known.frames += 1
            known.sample = None
            if known.samples < self._parameters.lookaround_ratio * known.frames:
                sample = self._next_sample(known)
                if sample is not None:
                    known.samples += 1.0
                    return sample.mode
        elif failures == 1 and known.sample is not None:
            return known.sample.mode
        return known.chain[min(failures // FAILURES_PER_STAGE, 3)].mode

    def report(self, destination: int, mode: PhyMode, *, acknowledged: bool) -> None:
        """See `RateControl`."""
        known = self._destinations.get(destination)
        if known is not None and mode.name in known.by_name:
            of_mode = known.by_name[mode.name]
            of_mode.attempts += 1
            of_mode.successes += acknowledged

    def _update(self, known: _Destination, frame_bytes: int) -> None:
        for each in known.modes:
            mode = each.mode
            ack_ns = response_mode(mode).duration_ns(ACK_BYTES)
            each.time_ns = OVERHEAD_NS + mode.duration_ns(frame_bytes) + ack_ns
            each.update(self._parameters.memory, self._parameters.most_evidence)
        by_throughput = sorted(known.modes, key=_Mode.throughput, reverse=True)
        lowest = known.modes[0]
        if by_throughput[0].throughput() > 0.0:
            best, second = by_throughput[0], by_throughput[1 if len(by_throughput) > 1 else 0]
            if second.throughput() == 0.0:
                second = lowest
            most_probable = max(by_throughput, key=lambda each: min(each.success or 0.0, 0.95))
            known.chain = [best, second, most_probable, lowest]
        else:
            known.chain = [lowest] * 4

    def _next_sample(self, known: _Destination) -> _Mode | None:
        """Mode to try now, each in turn in an order drawn anew; None for none that is worth it.

        What cannot beat the best mode even if it never failed waits for the first repetition of this frame.
        """
        if known.turn >= len(known.turns):
            known.turns = sorted(known.modes, key=lambda _: self._uniforms.draw())
            known.turn = 0
        sample = known.turns[known.turn]
        known.turn += 1
        best = known.chain[0]
        if sample is best:
            return None
        if sample.skips:
            sample.skips -= 1
            return None
        if 1.0 / sample.time_ns <= best.throughput():
            known.sample = sample
            known.samples += 0.5
            return None
        return sample


class DatagramModes(NamedTuple):
    """What one station sends its datagrams in."""

    broadcast: PhyMode
    data: PhyMode
    """To one station; the first of all, if it is learnt which is best."""
    rates: AdaptiveRate | None
    """None where the mode is fixed."""


def datagram_modes(config: RadioConfig, own: StationConfig, streams: RandomStreams) -> DatagramModes:
    """Return what a station's settings, or else everybody's, ask for."""
    width_mhz = config.bandwidth_mhz
    broadcast = phy_mode(own.broadcast_mode or config.broadcast_mode, width_mhz)
    data_mode = own.data_mode or config.data_mode
    if data_mode != "adaptive":
        return DatagramModes(broadcast, phy_mode(data_mode, width_mhz), None)
    modes = channel_modes(width_mhz, vht=True)
    rates = AdaptiveRate(modes, Uniforms(streams.generator(Model.RATE, own.station)))
    return DatagramModes(broadcast, modes[0], rates)

"""Rate control: selects the mode of each frame from the acknowledgements of earlier frames.

The algorithm is Minstrel of Linux mac80211: it keeps a moving average of the success probability by mode and
destination, sends in the mode of highest expected throughput first, and samples other modes with a fixed
share of frames. There are two differences. The average is weighted by attempts, not by intervals, so that a
few samples do not dominate. And a mode that keeps failing is sampled less and less often. Losses by collision
are not distinguished from other losses.
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
"""Success probability below which a mode's throughput counts as 0."""
LONGEST_REST = 15
"""Most consecutive sampling turns that a failing mode skips."""
FAILURES_PER_STAGE = 2


class RateControl(Protocol):
    """Selects the mode of each transmission attempt to a station, from the outcomes of earlier ones."""

    def mode_for(self, destination: int, *, frame_bytes: int, failures: int, now_ns: int) -> PhyMode:
        """Return the mode of the next attempt of a frame that has failed ``failures`` times."""

    def report(self, destination: int, mode: PhyMode, *, acknowledged: bool) -> None:
        """Record the outcome of an attempt in which the frame itself was sent."""


class RateParameters(Struct, frozen=True, kw_only=True):
    """Rate of adaptation. Minstrel has the same interval, memory 0.75 and lookaround ratio 0.1."""

    interval_ns: Annotated[int, Meta(ge=1_000_000)] = 100_000_000
    """Time between two updates of the averages."""
    memory: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.9
    """Factor by which the weight of an attempt decays per update."""
    most_evidence: Annotated[float, Meta(ge=1.0)] = 300.0
    """Largest weight of all attempts; limits the time to detect a change of a mode in use."""
    lookaround_ratio: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.05
    """Share of frames that may sample another mode."""


def channel_modes(bandwidth_mhz: BandwidthMhz, *, vht: bool) -> tuple[PhyMode, ...]:
    """Return all VHT or non-HT modes of a channel width in order of rate."""
    names: list[Mode] = [name for name in get_args(Mode) if name.startswith("vht") is vht]
    if bandwidth_mhz == 20 and vht:
        names.remove("vht_mcs9")
    return tuple(phy_mode(name, bandwidth_mhz) for name in names)


class _Mode:
    """Statistics of one mode to one destination."""

    __slots__ = ("attempts", "evidence", "mode", "rest", "skips", "success", "successes", "time_ns")

    def __init__(self, mode: PhyMode) -> None:
        self.mode = mode
        self.attempts = 0
        self.successes = 0
        """Attempts and successes since the last update."""
        self.success: float | None = None
        """Average success probability; None before the first attempt."""
        self.evidence = 0.0
        """Decayed number of attempts in that average."""
        self.time_ns = 1
        """Duration of an exchange without failures."""
        self.skips = 0
        self.rest = 0
        """Sampling turns left to skip, and the last number of turns to skip."""

    def throughput(self) -> float:
        """Return the expected frames per nanosecond."""
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
    """Rate control state of one destination."""

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
        """Mode to sample with the first retry."""
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
        """Select among ``modes``, the most robust first; ``uniforms`` draws the order of samples."""
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
        """Return the mode to sample now, in random order; None if it is not worth sampling.

        A mode that cannot exceed the best throughput even without failures is sampled with the first retry of
        this frame.
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
    """Modes of one station's datagrams."""

    broadcast: PhyMode
    data: PhyMode
    """Mode of unicast datagrams; the most robust one with rate control."""
    rates: AdaptiveRate | None
    """Rate control; None with a fixed mode."""


def datagram_modes(config: RadioConfig, own: StationConfig, streams: RandomStreams) -> DatagramModes:
    """Return the modes of a station from its own settings, else from the common ones."""
    width_mhz = config.bandwidth_mhz
    broadcast = phy_mode(own.broadcast_mode or config.broadcast_mode, width_mhz)
    data_mode = own.data_mode or config.data_mode
    if data_mode != "adaptive":
        return DatagramModes(broadcast, phy_mode(data_mode, width_mhz), None)
    modes = channel_modes(width_mhz, vht=True)
    rates = AdaptiveRate(modes, Uniforms(streams.generator(Model.RATE, own.station)))
    return DatagramModes(broadcast, modes[0], rates)

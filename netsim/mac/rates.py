"""Rate control: selects the mode of each frame from the acknowledgements of earlier frames.

The algorithm is Minstrel of Linux mac80211: it keeps a moving average of the success probability by mode and
destination, sends in the mode of highest expected throughput first, and samples other modes with a fixed
share of frames. There are two differences. The average is weighted by attempts, not by intervals, so that a
few samples do not dominate. And a mode that keeps failing is sampled less and less often. Losses by collision
are not distinguished from other losses.
"""

from typing import NamedTuple

from msgspec import Struct

from netsim.mac.access_parameters import DCF
from netsim.model.config import BandwidthMhz, RadioConfig, StationConfig
from netsim.model.random_streams import FloatStream, Model, RandomStreams
from netsim.phy.frames import ACK_BYTES
from netsim.phy.modes import MODE_NAMES, PhyMode, phy_mode, response_mode
from netsim.phy.timing import channel_mode, is_2_4_ghz, timing_of

OVERHEAD_NS = 34_000 + 67_500 + 16_000
"""Share of an exchange that no mode shortens, at 5 GHz: DIFS, the mean of the smallest backoff, SIFS."""
HOPELESS = 0.1
"""Success probability below which a mode's throughput counts as 0."""
LONGEST_REST = 15
"""Most consecutive sampling turns that a failing mode skips."""
FAILURES_PER_STAGE = 2

# Rate of adaptation. Minstrel has the same interval, memory 0.75 and lookaround ratio 0.1.
INTERVAL_NS = 100_000_000
"""Time between two updates of the averages."""
MEMORY = 0.9
"""Factor by which the weight of an attempt decays per update."""
MOST_EVIDENCE = 300.0
"""Largest weight of all attempts; limits the time to detect a change of a mode in use."""
LOOKAROUND_RATIO = 0.05
"""Share of frames that may sample another mode."""


def channel_modes(
    bandwidth_mhz: BandwidthMhz, *, vht: bool, signal_extension_ns: int = 0
) -> tuple[PhyMode, ...]:
    """Return all VHT or non-HT modes of a channel width in order of rate."""
    names = [name for name in MODE_NAMES if name.startswith("vht") is vht]
    if bandwidth_mhz == 20 and vht:
        names.remove("vht_mcs9")
    return tuple(phy_mode(name, bandwidth_mhz, signal_extension_ns) for name in names)


class _Mode(Struct, eq=False):
    """Statistics of one mode to one destination."""

    mode: PhyMode
    attempts: int = 0
    successes: int = 0
    """Attempts and successes since the last update."""
    success: float | None = None
    """Average success probability; None before the first attempt."""
    evidence: float = 0.0
    """Decayed number of attempts in that average."""
    time_ns: int = 1
    """Duration of an exchange without failures."""
    skips: int = 0
    rest: int = 0
    """Sampling turns left to skip, and the last number of turns to skip."""

    def throughput(self) -> float:
        """Return the expected frames per nanosecond."""
        success = self.success
        return success / self.time_ns if success is not None and success >= HOPELESS else 0.0

    def update(self) -> None:
        self.evidence *= MEMORY
        if not self.attempts:
            return
        kept = (self.success or 0.0) * self.evidence
        self.evidence += self.attempts
        self.success = (kept + self.successes) / self.evidence
        self.evidence = min(self.evidence, MOST_EVIDENCE)
        if self.success < HOPELESS:
            self.rest = min(2 * self.rest + 1, LONGEST_REST)
            self.skips = self.rest
        else:
            self.rest = self.skips = 0
        self.attempts = self.successes = 0


class _Destination:
    """Rate control state of one destination."""

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
        """Modes to sample in the following turns, the next one last."""


class AdaptiveRate:
    """Rate control of one station.

    It selects among ``modes``, the most robust first; ``uniforms`` draws the order of samples. An exchange
    takes ``overhead_ns`` more than its frame and ACK.
    """

    def __init__(
        self, modes: tuple[PhyMode, ...], uniforms: FloatStream, *, overhead_ns: int = OVERHEAD_NS
    ) -> None:
        self._modes = modes
        self._overhead_ns = overhead_ns
        self._uniforms = uniforms
        self._destinations: dict[int, _Destination] = {}

    def mode_for(self, destination: int, *, frame_bytes: int, failures: int, now_ns: int) -> PhyMode:
        """Return the mode of the next attempt of a frame that has failed ``failures`` times."""
        known = self._destinations.get(destination)
        if known is None:
            known = self._destinations[destination] = _Destination(self._modes)
        if now_ns >= known.update_ns:
            self._update(known, frame_bytes)
            known.update_ns = now_ns + INTERVAL_NS
        if failures == 0:
            known.frames += 1
            known.sample = None
            if known.samples < LOOKAROUND_RATIO * known.frames:
                sample = self._next_sample(known)
                if sample is not None:
                    known.samples += 1.0
                    return sample.mode
        elif failures == 1 and known.sample is not None:
            return known.sample.mode
        return known.chain[min(failures // FAILURES_PER_STAGE, 3)].mode

    def report(self, destination: int, mode: PhyMode, *, acknowledged: bool) -> None:
        """Record the outcome of an attempt in which the frame itself was sent."""
        known = self._destinations.get(destination)
        if known is not None and mode.name in known.by_name:
            of_mode = known.by_name[mode.name]
            of_mode.attempts += 1
            of_mode.successes += acknowledged

    def _update(self, known: _Destination, frame_bytes: int) -> None:
        for each in known.modes:
            mode = each.mode
            ack_ns = response_mode(mode).duration_ns(ACK_BYTES)
            each.time_ns = self._overhead_ns + mode.duration_ns(frame_bytes) + ack_ns
            each.update()
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
        if not known.turns:
            known.turns = sorted(known.modes, key=lambda _: self._uniforms.draw())[::-1]
        sample = known.turns.pop()
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
    broadcast = channel_mode(config, own.broadcast_mode or config.broadcast_mode)
    data_mode = own.data_mode or config.data_mode
    if data_mode != "adaptive":
        return DatagramModes(broadcast, channel_mode(config, data_mode), None)
    timing = timing_of(config)
    modes = channel_modes(
        config.bandwidth_mhz,
        vht=not is_2_4_ghz(config.frequency_mhz),
        signal_extension_ns=timing.signal_extension_ns,
    )
    overhead_ns = DCF.aifs_ns(timing) + DCF.cw_min * timing.slot_ns // 2 + timing.sifs_ns
    rates = AdaptiveRate(modes, streams.uniforms(Model.RATE, own.station), overhead_ns=overhead_ns)
    return DatagramModes(broadcast, modes[0], rates)

"""Rate control: selects the mode of each frame from the acknowledgements of earlier frames.

The algorithm is Minstrel of Linux mac80211: it keeps a moving average of the success probability by mode and
destination, sends in the mode of highest expected throughput first, and samples other modes with a fixed
share of frames. There are three differences. The average is weighted by attempts, not by intervals, so that a
few samples do not dominate. A mode that keeps failing is sampled less and less often. And losses by collision
do not lower the mode.

One missing acknowledgement does not distinguish a collision from noise, but the losses of several modes do:
collisions take the same share of the frames of all modes, noise takes less of those of slower modes. A
collision therefore leaves the order of the modes as it is, except by chance, and a retry in a slower mode
does not avoid the next one. Two rules follow:

- A slower mode replaces the one in use only if it is better beyond chance: it counts with the lower
  confidence limit of its success probability, a faster mode with the upper one (E. B. Wilson, "Probable
  inference, the law of succession, and statistical inference", JASA, 1927). Averages of a few samples would
  often favour one of the many slower modes.
- A frame falls back to slower modes after as many failures as are improbable at the loss that even the most
  successful mode has: two without collisions, more with them. Losses that are usual are no reason to fall
  back.
"""

from math import ceil, log, sqrt
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
RETRY_SAMPLE_REST = 3
"""Sampling turns that a mode skips after a sample with a retry."""
LONGEST_REST = 15
"""Most consecutive sampling turns that a failing mode skips."""
LEAST_FAILURES_PER_STAGE = 2
UNUSUAL = 0.01
"""Probability of a sequence of failures from which it counts as a change of the channel."""
CONFIDENCE = 1.0
"""Standard deviations between the average success probability of a mode and its confidence limits."""
ALIKE = 0.95
"""Share of the highest success probability from which modes count as equally probable; Minstrel: of 1."""

# Rate of adaptation. Minstrel has the same interval, memory 0.75 and lookaround ratio 0.1.
INTERVAL_NS = 100_000_000
"""Time between two updates of the averages."""
MEMORY = 0.9
"""Factor by which the weight of an attempt decays per update."""
MOST_EVIDENCE = 300.0
"""Largest weight of all attempts; limits the time to detect a change of a mode in use."""
LEAST_EVIDENCE = 5.0
"""Weight below which the decay does not reduce the attempts of a mode that has been sampled."""
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

    credible: float = 0.0
    """Success probability that counts: the average of the mode in use, the lower confidence limit of slower
    modes and the upper one of faster modes."""
    possible: float = 1.0
    """Upper confidence limit."""

    def throughput(self) -> float:
        """Return the expected frames per nanosecond."""
        return self.credible / self.time_ns if self.credible >= HOPELESS else 0.0

    def rate(self, in_use_ns: int) -> None:
        """Update ``credible`` and ``possible``; the mode in use has exchanges of ``in_use_ns``."""
        success, attempts = self.success, self.evidence
        if success is None:
            self.credible, self.possible = 0.0, 1.0
            return
        squared = CONFIDENCE**2
        spread = CONFIDENCE * sqrt(attempts * success * (1.0 - success) + 0.25 * squared)
        centre = attempts * success + 0.5 * squared
        self.possible = (centre + spread) / (attempts + squared)
        if self.time_ns == in_use_ns:
            self.credible = success
        elif self.time_ns < in_use_ns:
            self.credible = self.possible
        else:
            self.credible = (centre - spread) / (attempts + squared)

    def update(self) -> None:
        self.evidence = max(self.evidence * MEMORY, min(self.evidence, LEAST_EVIDENCE))
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
        self.stage_failures = LEAST_FAILURES_PER_STAGE
        """Failures of a frame in each stage."""
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
        """Return the mode of the next attempt of a frame that was sent ``failures`` times without an ACK."""
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
        return known.chain[min(failures // known.stage_failures, 3)].mode

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
        in_use_ns = known.chain[0].time_ns
        for each in known.modes:
            each.rate(in_use_ns)
        by_throughput = sorted(known.modes, key=_Mode.throughput, reverse=True)
        lowest = known.modes[0]
        known.stage_failures = LEAST_FAILURES_PER_STAGE
        if by_throughput[0].throughput() > 0.0:
            ceiling = max(each.credible for each in known.modes)
            best, second = by_throughput[0], by_throughput[1 if len(by_throughput) > 1 else 0]
            if second.throughput() == 0.0:
                second = lowest
            most_probable = next(each for each in known.modes[::-1] if each.credible >= ALIKE * ceiling)
            known.chain = [best, second, most_probable, lowest]
            known.stage_failures = usual_failures(ceiling)
        else:
            known.chain = [lowest] * 4

    def _next_sample(self, known: _Destination) -> _Mode | None:
        """Return the mode to sample now, in random order; None if it is not worth sampling.

        A slower mode that would not exceed the best throughput at the upper limit of its success probability
        is sampled with the first retry of this frame, and less often.
        """
        if not known.turns:
            known.turns = sorted(known.modes, key=lambda _: self._uniforms.draw())[::-1]
        sample = known.turns.pop()
        best = known.chain[0]
        if sample is best:
            return None
        if sample.skips:
            sample.skips -= 1
            if sample.time_ns > best.time_ns:
                known.samples += 0.5  # the turn counts, or failing faster modes would have more of them
            return None
        if sample.time_ns > best.time_ns and sample.possible / sample.time_ns <= best.throughput():
            known.sample = sample
            known.samples += 0.5
            sample.skips = RETRY_SAMPLE_REST
            return None
        return sample


def usual_failures(success: float) -> int:
    """Return the number of failures of one frame from which they are not usual.

    Independent losses of probability 1 - ``success`` in (0, 1] cause more with probability `UNUSUAL` or less.
    """
    loss = 1.0 - success
    if loss <= UNUSUAL ** (1.0 / LEAST_FAILURES_PER_STAGE):
        return LEAST_FAILURES_PER_STAGE
    return ceil(log(UNUSUAL) / log(loss))


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

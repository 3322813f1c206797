"""The shared medium: which transmissions overlap at whom, what each receiver locks on to, and what survives.

A transmission is three calls in time. At its start every receiver's energy detection learns of it; 4 us later
receivers find its preamble or not; when its end has reached the last of them, what they made of it is
settled, with every transmission known that overlapped it. All times at a receiver include the propagation
delay to it.

Left out: adjacent channels, and propagation longer than SIFS (4.8 km), beyond which 802.11's own timing
fails.
"""

from collections.abc import Callable
from itertools import pairwise
from math import exp
from typing import Protocol

from netsim.config import RadioConfig
from netsim.frames import GROUP, Frame
from netsim.kernel import EventQueue
from netsim.phy.errors import error_model
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, phy_mode
from netsim.phy.propagation import LinkRow, Links, RicianFading, thermal_noise_mw
from netsim.streams import Model, Streams, Uniforms

PREAMBLE_DETECTION_NS = 4_000
PREAMBLE_SINR = 10.0**0.4
"""Least ratio at which a preamble is found, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame takes over a receiver that is in an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000
SIGNAL_BITS = 24
"""Bits of L-SIG, at 6 Mbit/s."""
VHT_SIGNAL_BITS = 72
"""Bits of L-SIG and VHT-SIG-A."""


class Listener(Protocol):
    """What a receiver tells its MAC."""

    def on_busy(self, from_ns: int) -> None:
        """Note that the medium is busy from then on; that may lie ahead by the propagation delay."""

    def on_received(self, transmission: "Transmission", power_mw: float, end_ns: int) -> None:
        """Take a frame that was received whole, for whomever it is."""

    def on_error(self, end_ns: int) -> None:
        """Note that a frame which the receiver was locked on to ended in errors."""

    def on_sent(self, transmission: "Transmission") -> None:
        """Note that the own transmission has ended."""

    def on_air_changed(self) -> None:
        """Note that a transmission has ended at all receivers."""


class Transmission:
    """A frame on the air, and what became of it."""

    __slots__ = (
        "collided", "delays_ns", "delivered", "end_ns", "frame", "longest_delay_ns", "lost_to_noise",
        "overlaps", "powers_mw", "source", "start_ns",
    )  # fmt: skip

    def __init__(self, frame: Frame, start_ns: int, row: LinkRow, powers_mw: list[float]) -> None:
        self.frame = frame
        self.source = frame.source
        self.start_ns = start_ns
        self.end_ns = start_ns + frame.duration_ns
        self.powers_mw = powers_mw
        self.delays_ns = row.delays_ns
        self.longest_delay_ns = row.longest_delay_ns
        self.overlaps: list[Transmission] = []
        self.delivered: list[int] = []
        self.collided: list[int] = []
        self.lost_to_noise: list[int] = []


class Receiver:
    """One station's receiver: what it is locked on to and how long it senses the medium busy."""

    __slots__ = (
        "attentive",
        "busy_from_ns",
        "busy_until_ns",
        "idle_before_ns",
        "index",
        "listener",
        "lock",
        "locked_ns",
        "sending_until_ns",
        "uniforms",
    )

    def __init__(self, index: int, uniforms: Uniforms) -> None:
        self.index = index
        self.uniforms = uniforms
        self.listener: Listener
        self.attentive = True
        """Whether the listener wants `Listener.on_busy` and `Listener.on_air_changed`: most of the time most
        stations have nothing to send, and it does not matter to them."""
        self.lock: Transmission | None = None
        self.locked_ns = -1
        """When it last found a preamble."""
        self.sending_until_ns = -1
        self.busy_from_ns = 0
        self.busy_until_ns = 0
        """The last busy period; it may begin later than now by the propagation delay."""
        self.idle_before_ns = 0
        """End of the busy period before that one."""

    def occupy(self, from_ns: int, until_ns: int) -> None:
        """Sense the medium busy over an interval that begins now, or later by the propagation delay."""
        if from_ns > self.busy_until_ns:
            self.idle_before_ns = self.busy_until_ns
            self.busy_from_ns = from_ns
        elif from_ns < self.busy_from_ns:
            self.busy_from_ns = from_ns
        elif until_ns <= self.busy_until_ns:
            return
        if until_ns > self.busy_until_ns:
            self.busy_until_ns = until_ns
        if self.attentive:
            self.listener.on_busy(from_ns)


class Medium:
    """One channel."""

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        links: Links,
        stations: int,
        streams: Streams,
        on_ended: Callable[[Transmission], None],
    ) -> None:
        self._queue = queue
        self._links = links
        self._on_ended = on_ended
        self._fading = (
            None if config.rician_k_db is None else RicianFading(config.rician_k_db, stations, streams)
        )
        self._energy_mw = 10.0 ** (config.cca_energy_dbm / 10.0)
        self.noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        self._preamble_mw = max(10.0 ** (config.cca_preamble_dbm / 10.0), PREAMBLE_SINR * self.noise_mw)
        self._signal_errors = error_model(phy_mode("ofdm6", config.bandwidth_mhz))
        self._clean_linear: dict[str, float] = {}
        """By mode: from this ratio on a frame cannot fail."""
        self._active: list[Transmission] = []
        self._busy_ns = 0
        self._busy_until_ns = 0
        self.receivers = [
            Receiver(i, Uniforms(streams.generator(Model.RECEPTION, i))) for i in range(stations)
        ]
        self._others = [
            [receiver for receiver in self.receivers if receiver.index != i] for i in range(stations)
        ]
        """By source: who can hear it."""

    def busy_ns(self) -> int:
        """Time up to now for which the medium carried at least one transmission."""
        return self._busy_ns - max(0, self._busy_until_ns - self._queue.now_ns)

    def remove(self, station: int) -> None:
        """From now on this station hears nothing and is nobody's intended receiver."""
        self._others = [
            [receiver for receiver in others if receiver.index != station] for others in self._others
        ]
        self.receivers[station].lock = None

    def start(self, frame: Frame) -> Transmission:
        """Put a frame on the air now."""
        now = self._queue.now_ns
        source = frame.source
        row = self._links.row(source, now)
        powers_mw = row.powers_mw
        if self._fading is not None:
            gains = self._fading.gains(source)
            powers_mw = [power_mw * gain for power_mw, gain in zip(powers_mw, gains, strict=True)]
        transmission = Transmission(frame, now, row, powers_mw)
        end_ns = transmission.end_ns
        overlaps = transmission.overlaps
        for other in self._active:
            if other.end_ns + other.longest_delay_ns > now:
                overlaps.append(other)
                other.overlaps.append(transmission)
        self._active.append(transmission)
        if end_ns > self._busy_until_ns:
            self._busy_ns += end_ns - max(now, self._busy_until_ns)
            self._busy_until_ns = end_ns
        sender = self.receivers[source]
        sender.sending_until_ns = end_ns
        sender.lock = None
        energy_mw = self._energy_mw
        delays_ns = row.delays_ns
        for receiver in self._others[source]:
            r = receiver.index
            delay_ns = delays_ns[r]
            if overlaps:
                until_ns = self._energy_until_ns(transmission, r)
                if until_ns:
                    receiver.occupy(now + delay_ns, until_ns)
            elif powers_mw[r] >= energy_mw:
                if now + delay_ns <= receiver.busy_until_ns:
                    receiver.occupy(now + delay_ns, end_ns + delay_ns)
                    continue
                # what `occupy` comes down to on an idle medium
                receiver.idle_before_ns = receiver.busy_until_ns
                receiver.busy_from_ns = now + delay_ns
                receiver.busy_until_ns = end_ns + delay_ns
                if receiver.attentive:
                    receiver.listener.on_busy(now + delay_ns)
        self._queue.at(now + PREAMBLE_DETECTION_NS, self._detect, transmission)
        self._queue.at(end_ns + row.longest_delay_ns, self._end, transmission)
        return transmission

    def _energy_until_ns(self, newest: Transmission, r: int) -> int:
        """Until when all transmissions together keep up the energy threshold; 0 if they do not reach it."""
        ends = [
            (t.end_ns + t.delays_ns[r], t.powers_mw[r])
            for t in (newest, *newest.overlaps)
            if t.source != r and t.end_ns + t.delays_ns[r] > newest.start_ns + newest.delays_ns[r]
        ]
        ends.sort(reverse=True)
        total_mw = 0.0
        for end_ns, power_mw in ends:
            total_mw += power_mw
            if total_mw >= self._energy_mw:
                return end_ns
        return 0

    def _detect(self, transmission: Transmission) -> None:
        """Each free receiver looks for the preamble: strong enough, and 4 dB over noise and interference."""
        powers_mw, delays_ns = transmission.powers_mw, transmission.delays_ns
        start_ns, end_ns = transmission.start_ns, transmission.end_ns
        now = self._queue.now_ns
        least_mw = self._preamble_mw
        overlaps = transmission.overlaps
        for receiver in self._others[transmission.source]:
            r = receiver.index
            power_mw = powers_mw[r]
            arrival_ns = start_ns + delays_ns[r]
            if power_mw < least_mw or receiver.sending_until_ns > arrival_ns:
                continue
            found_ns = arrival_ns + PREAMBLE_DETECTION_NS
            if overlaps:
                floor_mw = self.noise_mw + self._interference_mw(transmission, r, arrival_ns, found_ns)
                if power_mw < PREAMBLE_SINR * floor_mw:
                    continue
                lock = receiver.lock
                if lock is not None and (
                    power_mw < CAPTURE_RATIO * lock.powers_mw[r]
                    or arrival_ns > lock.start_ns + lock.delays_ns[r] + CAPTURE_WINDOW_NS
                ):
                    continue
            receiver.lock = transmission
            receiver.locked_ns = now
            until_ns = end_ns + delays_ns[r]
            # as a rule the energy has said so before
            if until_ns > receiver.busy_until_ns or found_ns < receiver.busy_from_ns:
                receiver.occupy(found_ns, until_ns)

    @staticmethod
    def _interference_mw(transmission: Transmission, r: int, from_ns: int, to_ns: int) -> float:
        """Power of all other transmissions that are at receiver ``r`` at some time within an interval."""
        return sum(
            other.powers_mw[r]
            for other in transmission.overlaps
            if other.source != r
            and other.start_ns + other.delays_ns[r] < to_ns
            and other.end_ns + other.delays_ns[r] > from_ns
        )

    def _end(self, transmission: Transmission) -> None:
        self._active.remove(transmission)
        frame = transmission.frame
        destination = frame.destination
        group = destination == GROUP
        powers_mw, delays_ns = transmission.powers_mw, transmission.delays_ns
        overlaps, noise_mw = transmission.overlaps, self.noise_mw
        clean_linear = self._clean_linear.get(frame.mode.name) or self._cannot_fail(frame.mode)
        for receiver in self._others[frame.source]:
            r = receiver.index
            survived = locked = receiver.lock is transmission
            # one draw decides both whether the frame survives and whether it would have without the others
            draw: float | None = None
            if locked:
                receiver.lock = None
                if overlaps or powers_mw[r] / noise_mw < clean_linear:
                    survival = self._survival(transmission, r)
                    if survival < 1.0:
                        draw = receiver.uniforms.draw()
                        survived = draw < survival
            if group or destination == r:
                if survived:
                    transmission.delivered.append(r)
                elif self._would_survive_alone(transmission, receiver, draw):
                    transmission.collided.append(r)
                else:
                    transmission.lost_to_noise.append(r)
            if survived:
                receiver.listener.on_received(transmission, powers_mw[r], transmission.end_ns + delays_ns[r])
            elif locked:
                receiver.listener.on_error(transmission.end_ns + delays_ns[r])
            if receiver.attentive:
                receiver.listener.on_air_changed()
        self.receivers[frame.source].listener.on_sent(transmission)
        self._on_ended(transmission)

    def _cannot_fail(self, mode: PhyMode) -> float:
        """Ratio from which on neither signal field nor payload of a frame can fail."""
        clean_linear = max(self._signal_errors.clean_linear, error_model(mode).clean_linear)
        self._clean_linear[mode.name] = clean_linear
        return clean_linear

    def _would_survive_alone(
        self, transmission: Transmission, receiver: Receiver, draw: float | None
    ) -> bool:
        """Whether a lost frame would have been received had nothing else been on the air."""
        if not transmission.overlaps or transmission.powers_mw[receiver.index] < self._preamble_mw:
            return False
        alone = self._survival_at(transmission.frame, transmission.powers_mw[receiver.index] / self.noise_mw)
        return (receiver.uniforms.draw() if draw is None else draw) < alone

    def _survival_at(self, frame: Frame, sinr: float) -> float:
        """Probability that a frame survives at one ratio throughout, its signal field included."""
        mode = frame.mode
        signal_bits = VHT_SIGNAL_BITS if mode.vht else SIGNAL_BITS
        hazard = signal_bits * self._signal_errors.hazard_per_bit(sinr)
        hazard += 8 * frame.bytes * error_model(mode).hazard_per_bit(sinr)
        return exp(-hazard) if hazard > 0.0 else 1.0

    def _survival(self, transmission: Transmission, r: int) -> float:
        """Probability that a frame survives noise and each chunk's interference: exponents add."""
        frame = transmission.frame
        power_mw = transmission.powers_mw[r]
        if not transmission.overlaps:
            return self._survival_at(frame, power_mw / self.noise_mw)
        start_ns = transmission.start_ns + transmission.delays_ns[r]
        end_ns = start_ns + frame.duration_ns
        changes = [(start_ns, 0.0)]
        for other in transmission.overlaps:
            if other.source != r:
                other_start_ns = other.start_ns + other.delays_ns[r]
                other_end_ns = other.end_ns + other.delays_ns[r]
                if other_end_ns > start_ns and other_start_ns < end_ns:
                    changes.append((max(other_start_ns, start_ns), other.powers_mw[r]))
                    changes.append((min(other_end_ns, end_ns), -other.powers_mw[r]))
        changes.sort()
        changes.append((end_ns, 0.0))
        # the signal fields end where the payload begins; L-SIG is the last 4 us of the non-HT preamble
        signal_ns = (start_ns + NON_HT_PREAMBLE_NS - 4_000, start_ns + frame.mode.preamble_ns)
        payload_ns = (signal_ns[1], end_ns)
        signal_rate = (VHT_SIGNAL_BITS if frame.mode.vht else SIGNAL_BITS) / (signal_ns[1] - signal_ns[0])
        payload_rate = 8 * frame.bytes / (payload_ns[1] - payload_ns[0])
        payload_errors = error_model(frame.mode)
        hazard, interference_mw = 0.0, 0.0
        for (from_ns, change_mw), (to_ns, _) in pairwise(changes):
            interference_mw = max(0.0, interference_mw + change_mw)
            if to_ns == from_ns:
                continue
            sinr = power_mw / (self.noise_mw + interference_mw)
            in_signal_ns = min(to_ns, signal_ns[1]) - max(from_ns, signal_ns[0])
            if in_signal_ns > 0:
                hazard += in_signal_ns * signal_rate * self._signal_errors.hazard_per_bit(sinr)
            in_payload_ns = min(to_ns, payload_ns[1]) - max(from_ns, payload_ns[0])
            if in_payload_ns > 0:
                hazard += in_payload_ns * payload_rate * payload_errors.hazard_per_bit(sinr)
        return exp(-hazard) if hazard > 0.0 else 1.0

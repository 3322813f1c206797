"""The shared medium: which transmissions overlap at whom, what each receiver locks on to, and what survives.

A transmission is three calls in time. At its start every receiver's energy detection learns of it; 4 us later
receivers find its preamble or not; when its end has reached the last of them, what they made of it is
settled, with every transmission known that overlapped it. All times at a receiver include the propagation
delay to it. Interferers' bursts are signals that nobody can find a preamble in.

Clear channel assessment (IEEE 802.11-2016, 17.3.10.6): the medium is busy while all signals together are over
-62 dBm, and while a frame lasts that is over -82 dBm and 4 dB over the noise. Such a frame counts from its
arrival on, whatever else is on the air and whatever the receiver makes of it: the short training fields of
frames that collide trip a correlator all the same, and ns-3 takes frames as busy from its CCA sensitivity on.
That it takes 4 us is the MAC's matter (`netsim.mac.access.CCA_NS`). Both thresholds apply to the power in the
whole channel, which is more alert than the standard asks of wide channels.

Preambles are found from the same -82 dBm and 4 dB over noise and interference on, as with ns-3's
ThresholdPreambleDetection, and a frame 5 dB stronger that begins within 16 us of the one being received takes
its place, as with its SimpleFrameCaptureModel.

Left out: adjacent channels; secondary channels, as every frame occupies the whole channel; propagation longer
than SIFS (4.8 km), beyond which 802.11's own timing fails and nobody hears anybody; and giving up a frame
whose signal field failed: its receiver stays with it until it ends in errors.
"""

from collections.abc import Callable
from math import inf

from netsim.config import RadioConfig
from netsim.frames import GROUP, Frame
from netsim.kernel import EventQueue
from netsim.phy.interferers import Interferer
from netsim.phy.propagation import Links, thermal_noise_mw
from netsim.phy.signals import Listener, Receiver, Signal, Transmission
from netsim.phy.survival import Survival
from netsim.streams import Model, Streams, Uniforms

__all__ = ["Listener", "Medium", "Receiver", "Transmission"]

PREAMBLE_DETECTION_NS = 4_000
PREAMBLE_SINR = 10.0**0.4
"""Least ratio at which a preamble is found, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame takes over a receiver that is in an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000
BURST_PART_NS = 20_000_000
"""A longer burst goes on the air in parts, each with the powers of its beginning: receivers move."""


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
        self._fades = config.rician_k_db is not None
        self._energy_mw = 10.0 ** (config.cca_energy_dbm / 10.0)
        self.noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        self._preamble_mw = max(10.0 ** (config.cca_preamble_dbm / 10.0), PREAMBLE_SINR * self.noise_mw)
        self._sensed_mw = min(self._energy_mw, self._preamble_mw)
        """Least power of a frame that is sensed by itself."""
        self._survival = Survival(config.bandwidth_mhz, self.noise_mw)
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
        self._bursts: list[Signal] = []
        for index, settings in enumerate(config.interferers):
            if settings.duty_cycle > 0.0:
                interferer = Interferer(index, settings, streams.generator(Model.INTERFERENCE, index))
                queue.at(queue.now_ns + interferer.first_ns(), self._begin_burst, interferer)

    def busy_ns(self) -> int:
        """Time up to now for which the medium carried at least one signal."""
        return self._busy_ns - max(0, self._busy_until_ns - self._queue.now_ns)

    def remove(self, station: int) -> None:
        """From now on this station hears nothing and is nobody's intended receiver."""
        self._others = [
            [receiver for receiver in others if receiver.index != station] for others in self._others
        ]
        self.receivers[station].lock = None

    def _carry(self, signal: Signal) -> None:
        """Count the time that a signal which begins now occupies."""
        if signal.end_ns > self._busy_until_ns:
            self._busy_ns += signal.end_ns - max(signal.start_ns, self._busy_until_ns)
            self._busy_until_ns = signal.end_ns

    def start(self, frame: Frame) -> Transmission:
        """Put a frame on the air now."""
        now = self._queue.now_ns
        source = frame.source
        row = self._links.row(source, now)
        powers_mw = row.powers_mw
        if self._fades:
            gains = self._links.fading_gains(source, now)
            powers_mw = [power_mw * gain for power_mw, gain in zip(powers_mw, gains, strict=True)]
        transmission = Transmission(frame, now, row, powers_mw)
        end_ns = transmission.end_ns
        overlaps = transmission.overlaps
        for other in self._active:
            if other.end_ns + other.longest_delay_ns > now:
                overlaps.append(other)
                other.overlaps.append(transmission)
        if self._bursts:
            overlaps.extend(self._bursts)
        self._active.append(transmission)
        self._carry(transmission)
        self.receivers[source].send(now, end_ns)
        delays_ns = row.delays_ns
        sensed_mw = self._sensed_mw
        for receiver in self._others[source]:
            r = receiver.index
            arrival_ns = now + delays_ns[r]
            if powers_mw[r] < sensed_mw:
                if overlaps:
                    until_ns = self._energy_until_ns(transmission, r)
                    if until_ns:
                        receiver.occupy(arrival_ns, until_ns)
            elif arrival_ns <= receiver.busy_until_ns:
                receiver.occupy(arrival_ns, end_ns + delays_ns[r])
            else:
                # what `occupy` comes down to on an idle medium
                receiver.ended_busy_ns += receiver.busy_until_ns - receiver.busy_from_ns
                receiver.idle_before_ns = receiver.busy_until_ns
                receiver.busy_from_ns = arrival_ns
                receiver.busy_until_ns = end_ns + delays_ns[r]
                if receiver.attentive:
                    receiver.listener.on_busy(arrival_ns)
        self._queue.at(now + PREAMBLE_DETECTION_NS, self._detect, transmission)
        self._queue.at(end_ns + row.longest_delay_ns, self._end, transmission)
        return transmission

    def _begin_burst(self, interferer: Interferer) -> None:
        self._radiate((interferer, self._queue.now_ns + interferer.burst_ns()))

    def _radiate(self, rest: tuple[Interferer, int]) -> None:
        """Put what is left of a burst on the air, or the next part of it."""
        interferer, until_ns = rest
        now = self._queue.now_ns
        end_ns = min(until_ns, now + BURST_PART_NS)
        # what follows at once is on the air before this has ended everywhere
        if end_ns < until_ns:
            self._queue.at(end_ns, self._radiate, rest)
        else:
            self._queue.at(end_ns + interferer.pause_ns(), self._begin_burst, interferer)
        row = self._links.interferer_row(interferer.index, now)
        burst = Signal(-1 - interferer.index, now, end_ns, row, row.powers_mw)
        for other in self._active:
            if other.end_ns + other.longest_delay_ns > now:
                burst.overlaps.append(other)
                other.overlaps.append(burst)
        burst.overlaps.extend([other for other in self._bursts if other.source != burst.source])
        self._bursts.append(burst)
        self._carry(burst)
        for receiver in self.receivers:
            energy_until_ns = self._energy_until_ns(burst, receiver.index)
            if energy_until_ns:
                receiver.occupy(now + row.delays_ns[receiver.index], energy_until_ns)
        burst.overlaps.clear()  # asked for only now; kept, each burst would keep all before it
        self._queue.at(end_ns + row.longest_delay_ns, self._end_burst, burst)

    def _end_burst(self, burst: Signal) -> None:
        self._bursts.remove(burst)
        for receiver in self.receivers:
            if receiver.attentive:
                receiver.listener.on_air_changed()

    def _energy_until_ns(self, newest: Signal, r: int) -> int:
        """Until when all signals together keep up the energy threshold; 0 if they do not reach it.

        For bursts, and frames that are not sensed by themselves. What the others amount to without the newest
        has been added up before.
        """
        arrival_ns = newest.start_ns + newest.delays_ns[r]
        last_ns, last_mw = newest.end_ns + newest.delays_ns[r], newest.powers_mw[r]
        ends = [(last_ns, last_mw)]
        for other in newest.overlaps:
            end_ns = other.end_ns + other.delays_ns[r]
            if other.source != r and end_ns > arrival_ns:
                ends.append((end_ns, other.powers_mw[r]))
                if end_ns > last_ns:
                    last_ns, last_mw = ends[-1]
        if last_mw >= self._energy_mw:
            return last_ns
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
        start_ns = transmission.start_ns
        now = self._queue.now_ns
        least_mw = self._preamble_mw
        overlaps = transmission.overlaps
        for receiver in self._others[transmission.source]:
            r = receiver.index
            power_mw = powers_mw[r]
            arrival_ns = start_ns + delays_ns[r]
            if power_mw < least_mw or receiver.sending_until_ns > arrival_ns:
                continue
            if overlaps:
                found_ns = arrival_ns + PREAMBLE_DETECTION_NS
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

    @staticmethod
    def _interference_mw(transmission: Transmission, r: int, from_ns: int, to_ns: int) -> float:
        """Power of all other signals that are at receiver ``r`` at some time within an interval."""
        total_mw = 0.0
        for other in transmission.overlaps:
            delay_ns = other.delays_ns[r]
            if other.source != r and other.start_ns + delay_ns < to_ns and other.end_ns + delay_ns > from_ns:
                total_mw += other.powers_mw[r]
        return total_mw

    def _end(self, transmission: Transmission) -> None:
        self._active.remove(transmission)
        frame = transmission.frame
        destination = frame.destination
        group = destination == GROUP
        end_ns = transmission.end_ns
        powers_mw, delays_ns = transmission.powers_mw, transmission.delays_ns
        # nothing is drawn for a frame that is certain to survive
        doubtful_mw = inf if transmission.overlaps else self._survival.clean_mw(frame.mode)
        for receiver in self._others[frame.source]:
            r = receiver.index
            if receiver.lock is transmission:
                receiver.lock = None
                # one draw decides whether the frame survives, and whether it would have without the others
                draw = 0.0
                survival = 1.0
                if powers_mw[r] < doubtful_mw:
                    survival = self._survival.among_others(transmission, r)
                    if survival < 1.0:
                        draw = receiver.uniforms.draw()
                if draw < survival:
                    if group or destination == r:
                        transmission.delivered.append(r)
                    receiver.listener.on_received(transmission, powers_mw[r], end_ns + delays_ns[r])
                else:
                    if group or destination == r:
                        self._blame(transmission, r, draw)
                    receiver.listener.on_error(end_ns + delays_ns[r])
            elif group or destination == r:
                self._blame(transmission, r, None)
            if receiver.attentive:
                receiver.listener.on_air_changed()
        sender = self.receivers[frame.source]
        sender.sent()
        sender.listener.on_sent(transmission)
        self._on_ended(transmission)

    def _blame(self, transmission: Transmission, r: int, draw: float | None) -> None:
        """Note whether a lost frame would have been received had nothing else been on the air."""
        power_mw = transmission.powers_mw[r]
        if transmission.overlaps and power_mw >= self._preamble_mw:
            if draw is None:
                draw = self.receivers[r].uniforms.draw()
            if draw < self._survival.alone(transmission.frame, power_mw):
                transmission.collided.append(r)
                return
        transmission.lost_to_noise.append(r)

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

import numpy as np

from netsim.config import RadioConfig
from netsim.frames import GROUP, Frame
from netsim.kernel import EventQueue
from netsim.phy.interferers import Interferer
from netsim.phy.propagation import Links, thermal_noise_mw
from netsim.phy.sensing import (
    ABSENT,
    BROKE,
    DEAF,
    HEEDS_END,
    IN_DOUBT,
    LOCK,
    LOCKED,
    NEVER_HEARD,
    NOBODY,
    RECEIVED,
    RESERVED_UNTIL,
    UNLOCKED,
    arrive,
    conclude,
    find,
    first_state,
    settle,
    unused,
)
from netsim.phy.signals import Listener, Receiver, Signal, Transmission, none_of
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
        self._started = 0
        self._busy_ns = 0
        self._busy_until_ns = 0
        self.state = first_state(stations)
        """What all stations sense: see `netsim.phy.sensing`."""
        self.heard_ns = np.full((stations, stations), NEVER_HEARD)
        self.heard_mw = np.zeros((stations, stations))
        """When and how loud each station, by row, last heard a frame of each other that was no answer."""
        self.receivers = [
            Receiver(i, self.state, Uniforms(streams.generator(Model.RECEPTION, i))) for i in range(stations)
        ]
        self._locks_mw = np.zeros(stations)
        self._fates = np.zeros(stations, dtype=np.int64)
        self._told = np.zeros(stations, dtype=np.int64)
        self._nothing = none_of(stations)
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
        row = self.receivers[station].row
        row[DEAF] = 1
        row[LOCK] = UNLOCKED

    def start(self, frame: Frame) -> Transmission:
        """Put a frame on the air now."""
        now = self._queue.now_ns
        source = frame.source
        row = self._links.row(source, now)
        powers_mw = row.powers_mw
        if self._fades:
            powers_mw = powers_mw * self._links.fading_gains(source, now)
        self._started += 1
        transmission = Transmission(frame, now, row, powers_mw, self._started)
        for other in self._active:
            if other.end_ns + other.longest_delay_ns > now:
                transmission.overlaps.append(other)
                other.overlaps.append(transmission)
        if self._bursts:
            transmission.overlaps.extend(self._bursts)
        self._active.append(transmission)
        self.receivers[source].send(now, transmission.end_ns)
        self._radiate(transmission, self._sensed_mw)
        self._queue.at(now + PREAMBLE_DETECTION_NS, self._detect, transmission)
        self._queue.at(transmission.end_ns + row.longest_delay_ns, self._end, transmission)
        return transmission

    def _radiate(self, signal: Signal, sensed_mw: float) -> None:
        """Have the stations sense a signal that begins now, from ``sensed_mw`` on by itself."""
        if signal.end_ns > self._busy_until_ns:
            self._busy_ns += signal.end_ns - max(signal.start_ns, self._busy_until_ns)
            self._busy_until_ns = signal.end_ns
        count = arrive(
            self.state,
            signal.source,
            signal.start_ns,
            signal.end_ns,
            signal.powers_mw,
            signal.delays_ns,
            sensed_mw,
            self._energy_mw,
            *(signal.others() if signal.overlaps else self._nothing),
            self._told,
        )
        if count:
            for r in self._told[:count].tolist():
                self.receivers[r].listener.on_busy(signal.start_ns + signal.delay_ns(r))

    def _begin_burst(self, interferer: Interferer) -> None:
        self._go_on(interferer, self._queue.now_ns + interferer.burst_ns())

    def _on_rest(self, rest: tuple[Interferer, int]) -> None:
        self._go_on(*rest)

    def _go_on(self, interferer: Interferer, until_ns: int) -> None:
        """Put what is left of a burst on the air, or the next part of it."""
        now = self._queue.now_ns
        end_ns = min(until_ns, now + BURST_PART_NS)
        # what follows at once is on the air before this has ended everywhere
        if end_ns < until_ns:
            self._queue.at(end_ns, self._on_rest, (interferer, until_ns))
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
        self._radiate(burst, inf)
        burst.forget_others()  # asked for only now; kept, each burst would keep all before it
        self._queue.at(end_ns + row.longest_delay_ns, self._end_burst, burst)

    def _end_burst(self, burst: Signal) -> None:
        self._bursts.remove(burst)
        for receiver in self.receivers:
            if receiver.row[HEEDS_END]:
                receiver.listener.on_air_changed()

    def _detect(self, transmission: Transmission) -> None:
        """Each free receiver looks for the preamble: strong enough, and 4 dB over noise and interference."""
        find(
            self.state,
            transmission.number,
            transmission.source,
            transmission.start_ns,
            self._queue.now_ns,
            transmission.powers_mw,
            transmission.delays_ns,
            self._preamble_mw,
            self.noise_mw,
            PREAMBLE_SINR,
            CAPTURE_RATIO,
            CAPTURE_WINDOW_NS,
            *(transmission.others() if transmission.overlaps else self._nothing),
            self._locks_mw,
        )

    def _end(self, transmission: Transmission) -> None:
        self._active.remove(transmission)
        frame = transmission.frame
        # nothing is drawn for a frame that is certain to survive
        doubtful_mw = inf if transmission.overlaps else self._survival.clean_mw(frame.mode)
        draws: dict[int, float] = {}
        course = (
            frame.destination,
            transmission.end_ns,
            frame.nav_ns,
            frame.destination if frame.is_answer else frame.source,
            NOBODY if frame.is_answer else frame.source,
            transmission.powers_mw,
            transmission.delays_ns,
            self.heard_ns,
            self.heard_mw,
            self._told,
        )
        count = settle(self.state, self._fates, transmission.number, frame.source, doubtful_mw, *course)
        if count == IN_DOUBT:
            draws = self._judge(transmission, doubtful_mw)
            count = conclude(self.state, self._fates, *course)
        if frame.destination == GROUP:
            for r, fate in enumerate(self._fates.tolist()):
                self._note(transmission, r, fate, draws)
        else:
            self._note(transmission, frame.destination, self._fates.item(frame.destination), draws)
        if count:
            self._tell(transmission, self._told[:count].tolist())
        if frame.lapse_ns:
            self._queue.at(transmission.end_ns + frame.lapse_ns, self._look_for_unused, transmission)
        sender = self.receivers[frame.source]
        sender.sent()
        sender.listener.on_sent(transmission)
        self._on_ended(transmission)

    def _judge(self, transmission: Transmission, doubtful_mw: float) -> dict[int, float]:
        """Find out where a frame survives; returns what was drawn, by receiver.

        One draw decides whether it survives, and whether it would have without the others.
        """
        draws: dict[int, float] = {}
        for r in np.flatnonzero(self._fates == RECEIVED).tolist():
            if transmission.power_mw(r) < doubtful_mw:
                survival = self._survival.among_others(transmission, r)
                if survival < 1.0:
                    draws[r] = self.receivers[r].uniforms.draw()
                    if draws[r] >= survival:
                        self._fates[r] = BROKE
        return draws

    def _note(self, transmission: Transmission, r: int, fate: int, draws: dict[int, float]) -> None:
        """Note whether an intended receiver got a frame, and if not, whether it would have got it alone."""
        if fate == RECEIVED:
            transmission.delivered.append(r)
        elif fate != ABSENT:
            power_mw = transmission.power_mw(r)
            if transmission.overlaps and power_mw >= self._preamble_mw:
                draw = draws[r] if fate == BROKE else self.receivers[r].uniforms.draw()
                if draw < self._survival.alone(transmission.frame, power_mw):
                    transmission.collided.append(r)
                    return
            transmission.lost_to_noise.append(r)

    def _tell(self, transmission: Transmission, told: list[int]) -> None:
        """Tell listeners that a frame has ended, and what their receivers made of it."""
        for r in told:
            listener, fate = self.receivers[r].listener, self._fates.item(r)
            end_ns = transmission.end_ns + transmission.delay_ns(r)
            if fate == RECEIVED:
                listener.on_received(transmission, transmission.power_mw(r), end_ns)
            elif fate == BROKE:
                listener.on_error(end_ns)
            listener.on_air_changed()

    # --- reservations that nobody uses

    def _look_for_unused(self, transmission: Transmission) -> None:
        """Have a reservation fall where nothing was heard after the frame that made it (10.3.2.4)."""
        count = unused(
            self.state, transmission.end_ns, transmission.frame.nav_ns, transmission.delays_ns, self._told
        )
        for r in self._told[:count].tolist():
            end_ns = transmission.end_ns + transmission.delay_ns(r)
            until_ns = end_ns + transmission.frame.nav_ns
            self._queue.at(end_ns + transmission.frame.lapse_ns, self._on_unused, (r, end_ns, until_ns))

    def _on_unused(self, reservation: tuple[int, int, int]) -> None:
        r, end_ns, until_ns = reservation
        row = self.receivers[r].row
        if row[RESERVED_UNTIL] == until_ns and row[LOCKED] <= end_ns:
            row[RESERVED_UNTIL] = self._queue.now_ns
            self.receivers[r].listener.on_unused()

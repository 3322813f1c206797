"""Pairs of serial modems: bytes of each host in, bytes of the other end and reports out.

End 2 i is the modem of pair i at the vehicle, end 2 i + 1 that at the ground station. Times are simulated
time in ns. Results depend on settings, seed, path gains and submissions alone, not on the order in which ends
submit, nor on how an interval is divided into calls of `SerialLinks.run_until`.

At time 0 the ends of each pair are synchronised, in a random phase of their round. Propagation delays, a
quarter of a tick per kilometre, are left out.
"""

import heapq
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct

from netsim.model.event_queue import NEVER_NS
from netsim.model.random_streams import Model, RandomStreams
from netsim.serial_radio.air import Air, AirTransmission
from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.errors import PacketErrors, Reception, noise_mw, rssi
from netsim.serial_radio.gains import LinkGains
from netsim.serial_radio.hopping import channel_count, frequencies_hz, occupied_hz
from netsim.serial_radio.modem import Modem, RadioStatus, SentPacket
from netsim.serial_radio.timing import (
    LINK_UPDATE_TICKS,
    PREAMBLE_DETECTION_BITS,
    TICK_NS,
    make_timing,
)

PART_NS = 5_000_000
"""Longest part of a packet for which fading and interference are taken as constant."""


class Delivery(NamedTuple):
    """Bytes that have arrived at a host: a MAVLink frame, or what else a packet had."""

    end: int
    at_ns: int
    """Time of the last byte."""
    data: bytes


class StatusReport(NamedTuple):
    """A RADIO_STATUS that a modem has sent to its host."""

    end: int
    at_ns: int
    """Time of its last byte."""
    status: RadioStatus


class SerialCounters(Struct, frozen=True, kw_only=True):
    """Counters of one end since the start."""

    packets_sent: int
    """Packets with data, also those sent a second time."""
    packets_received: int
    """Packets with data without errors left."""
    packets_rejected: int
    """Packets that were detected and discarded."""
    packets_corrected: int
    host_dropped_bytes: int
    """Bytes that the buffer of the host's serial port had no space for."""
    input_dropped_bytes: int
    """Bytes from the host that the modem's buffer had no space for."""
    output_dropped_bytes: int
    """Received bytes that the modem's buffer had no space for."""


class _End:
    """One modem in its surroundings; implements `netsim.serial_radio.modem.Environment`."""

    def __init__(self, links: "SerialLinks", number: int, station: int, modem: Modem) -> None:
        self._links = links
        self.number = number
        self.station = station
        self.modem = modem
        self.partner: _End
        self.uniforms = links.streams.uniforms(Model.SERIAL_RADIO, number)
        self.packets_sent = 0
        self.packets_received = 0

    def uniform(self) -> float:
        """Return a random number in [0, 1)."""
        return self.uniforms.draw()

    def noise_rssi(self, at_ns: int) -> int:
        """Return the present strength of noise and interference on the modem's channel."""
        return self._links.noise_rssi(self, at_ns)

    def incoming_until_ns(self, at_ns: int) -> int:
        """Return the end of a packet whose preamble the modem has detected, or 0."""
        return self._links.incoming_until_ns(self, at_ns)


class SerialLinks:
    """All pairs of serial modems of a run."""

    def __init__(
        self,
        config: SerialRadioConfig,
        pairs: Sequence[tuple[int, int]],
        gains: LinkGains,
        seed: np.random.SeedSequence,
    ) -> None:
        """Create the modems of ``pairs`` of stations: the vehicle's, and that of its ground station."""
        channels = channel_count(config)
        self.timing = timing = make_timing(config, channels)
        self._gains = gains
        self.streams = RandomStreams(seed)
        self._errors = PacketErrors(config, timing)
        self._power_mw: float = 10.0 ** (config.tx_power_dbm / 10.0)
        self._noise_mw = noise_mw(config)
        self._noise_rssi = rssi(self._noise_mw)
        longest_ns = timing.air_bytes(timing.max_payload_bytes + 2) * timing.byte_ns
        self._air = Air(occupied_hz(config.air_rate_kbps), longest_ns)
        self._frequencies_hz = [frequencies_hz(config, config.first_net_id + i) for i in range(len(pairs))]
        self._ends: list[_End] = []
        self._queue: list[tuple[int, int]] = []
        """Times of steps and ends; entries that differ from `Modem.next_ns` are obsolete."""
        self.reached_ns = 0
        """Time up to which everything has been simulated."""
        self._deliveries: list[tuple[int, int, int, bytes]] = []
        """Heap of what is on its way to the hosts: arrival, end, a number in order of reception, bytes."""
        self._reports: list[tuple[int, int, RadioStatus]] = []
        """Heap of reports on their way: arrival, end, fields."""
        self._numbered = 0
        for pair, stations in enumerate(pairs):
            vehicle, ground = (
                _End(self, 2 * pair + side, stations[side], Modem(config, timing, channels))
                for side in (0, 1)
            )
            vehicle.partner, ground.partner = ground, vehicle
            self._ends += vehicle, ground
            self._begin(vehicle, ground, channels)

    def _begin(self, vehicle: _End, ground: _End, channels: int) -> None:
        """Set the random phases of a pair."""
        half = self.timing.window + self.timing.silence
        generator = self.streams.generator(Model.SERIAL_RADIO, vehicle.number, ground.number)
        phase, hop = int(generator.integers(2 * half)), int(generator.integers(channels))
        updates_ns = generator.integers(LINK_UPDATE_TICKS * TICK_NS, size=2).tolist()
        vehicle.modem.begin(phase, hop, updates_ns[0])
        # the ground's last window is after or before that of the vehicle
        ground.modem.begin((phase + half) % (2 * half), hop + (1 if phase >= half else -1), updates_ns[1])
        for end in (vehicle, ground):
            heapq.heappush(self._queue, (end.modem.next_ns, end.number))

    def submit(self, end: int, data: bytes, at_ns: int) -> bool:
        """Transfer bytes from an end's host to its modem, from ``at_ns`` on or from now.

        Returns False if the buffer of the host's serial port has too little space for them; they are dropped.
        """
        return self._ends[end].modem.input.submit(data, max(at_ns, self.reached_ns))

    def run_until(self, to_ns: int) -> None:
        """Simulate up to and including ``to_ns``."""
        queue = self._queue
        while queue and queue[0][0] <= to_ns:
            at_ns, number = heapq.heappop(queue)
            end = self._ends[number]
            if end.modem.next_ns == at_ns:
                self._step(end, at_ns)
        self.reached_ns = max(self.reached_ns, to_ns)

    def take(self) -> list[Delivery]:
        """Return what has arrived at the hosts since the last call, by time and end."""
        taken: list[Delivery] = []
        waiting = self._deliveries
        while waiting and waiting[0][0] <= self.reached_ns:
            at_ns, end, _, data = heapq.heappop(waiting)
            taken.append(Delivery(end, at_ns, data))
        return taken

    def take_reports(self) -> list[StatusReport]:
        """Return the reports that have arrived at the hosts since the last call, by time and end."""
        taken: list[StatusReport] = []
        waiting = self._reports
        while waiting and waiting[0][0] <= self.reached_ns:
            at_ns, end, status = heapq.heappop(waiting)
            taken.append(StatusReport(end, at_ns, status))
        return taken

    @property
    def next_event_ns(self) -> int:
        """Time before which no modem acts and nothing arrives at a host without further submissions."""
        heaps: tuple[list[Any], ...] = (self._queue, self._deliveries, self._reports)
        return min((heap[0][0] for heap in heaps if heap), default=NEVER_NS)

    def counters(self, end: int) -> SerialCounters:
        """Return the counters of an end."""
        found = self._ends[end]
        modem = found.modem
        return SerialCounters(
            packets_sent=found.packets_sent,
            packets_received=found.packets_received,
            packets_rejected=modem.rx_errors,
            packets_corrected=modem.corrected_packets,
            host_dropped_bytes=modem.input.host_dropped_bytes,
            input_dropped_bytes=modem.input.overflow_bytes,
            output_dropped_bytes=modem.output.overflow_bytes,
        )

    def _step(self, end: _End, at_ns: int) -> None:
        """Let a modem act, and its partner receive what it has sent."""
        modem = end.modem
        ended = modem.sending
        if ended is not None:
            self._receive(end, end.partner, ended)
        if modem.source.heartbeat_version:
            report = modem.take_status(at_ns)
            if report is not None:
                heapq.heappush(self._reports, (report[0], end.number, report[1]))
        modem.step(at_ns, end)
        sending = modem.sending
        if sending is not None:
            end.packets_sent += bool(sending.data)
            frequency_hz = self._frequency_hz(end, sending.hop)
            self._air.add(AirTransmission(sending.start_ns, sending.end_ns, end.number, frequency_hz), at_ns)
        heapq.heappush(self._queue, (modem.next_ns, end.number))

    def _receive(self, sender: _End, receiver: _End, packet: SentPacket) -> None:
        """Determine what the receiver makes of a packet that ends now."""
        modem, uniform = receiver.modem, sender.uniform()
        if not modem.can_receive(packet):
            return
        power_mw, rates = self._bit_error_rates(sender, receiver, packet)
        outcome = self._errors.outcome(uniform, packet.data_bytes, rates)
        if outcome is Reception.MISSED:
            return
        strength = rssi(power_mw + self._noise_mw)
        if outcome is Reception.ERROR:
            modem.reject(strength, packet.end_ns)
            return
        receiver.packets_received += bool(packet.data)
        pieces = modem.receive(packet, strength, packet.end_ns, corrected=outcome is Reception.CORRECTED)
        for at_ns, piece in pieces:
            self._numbered += 1
            heapq.heappush(self._deliveries, (at_ns, receiver.number, self._numbered, piece))
        heapq.heappush(self._queue, (modem.next_ns, receiver.number))

    def _bit_error_rates(self, sender: _End, receiver: _End, packet: SentPacket) -> tuple[float, list[float]]:
        """Return the power at the beginning of a packet, and the bit error rates of its equal parts."""
        start_ns, duration_ns = packet.start_ns, packet.end_ns - packet.start_ns
        mean_mw = self._power_mw * self._gains.gain(sender.station, receiver.station, start_ns)
        others = self._air.overlapping(
            sender.number // 2, self._frequency_hz(sender, packet.hop), start_ns, packet.end_ns
        )
        parts = -(-duration_ns // PART_NS)
        times_ns = [start_ns + duration_ns * (2 * k + 1) // (2 * parts) for k in range(parts)]
        fading = self._gains.fading(sender.station, receiver.station, times_ns)
        if fading is None and not others:
            return mean_mw, [self._errors.bit_error_rate(mean_mw)]
        powers_mw = [mean_mw] * parts if fading is None else [mean_mw * gain for gain in fading]
        interference_mw = [0.0] * parts
        for other, passed in others:
            other_mw = passed * self._power_from(other, receiver)
            for k in range(parts):
                begin_ns = start_ns + duration_ns * k // parts
                end_ns = start_ns + duration_ns * (k + 1) // parts
                both_ns = min(end_ns, other.end_ns) - max(begin_ns, other.start_ns)
                interference_mw[k] += other_mw * max(0, both_ns) / (end_ns - begin_ns)
        return powers_mw[0], list(map(self._errors.bit_error_rate, powers_mw, interference_mw))

    def _frequency_hz(self, end: _End, hop: int) -> int:
        return self._frequencies_hz[end.number // 2][hop]

    def _power_from(self, other: AirTransmission, receiver: _End) -> float:
        """Return the mean power of another pair's packet at a receiver, before its filter."""
        return self._power_mw * self._gains.gain(
            self._ends[other.end].station, receiver.station, other.start_ns
        )

    def noise_rssi(self, end: _End, at_ns: int) -> int:
        """Return the strength of noise and interference at an end on its present channel."""
        frequency_hz = self._frequency_hz(end, end.modem.hopping.receive)
        others = self._air.overlapping(end.number // 2, frequency_hz, at_ns, at_ns + 1)
        if not others:
            return self._noise_rssi
        return rssi(self._noise_mw + sum(passed * self._power_from(other, end) for other, passed in others))

    def incoming_until_ns(self, end: _End, at_ns: int) -> int:
        """Return the end of a packet of the partner whose preamble an end has detected, or 0."""
        packet = end.partner.modem.sending
        if packet is None or not end.modem.can_receive(packet):
            return 0
        if at_ns < packet.start_ns + PREAMBLE_DETECTION_BITS * self.timing.byte_ns // 8:
            return 0
        power_mw = self._power_mw * self._gains.gain(end.partner.station, end.station, packet.start_ns)
        wrong = self._errors.bit_error_rate(power_mw)
        return packet.end_ns if (1.0 - wrong) ** PREAMBLE_DETECTION_BITS > 0.5 else 0

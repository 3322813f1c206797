"""One modem: time-division multiplexing, yielded windows, link statistics and RADIO_STATUS.

Facts of Firmware/radio/tdm.c and mavlink.c of ArduPilot/SiK, revision 50189f2. A modem sends in its own
window until it has nothing to send. Then it sends an empty packet, by which it yields the rest of the window:
the other end may send there until it has nothing either. So an idle link has four empty packets in a round,
and new data wait for the next of two moments in a round. Each packet's trailer states how much of the
sender's window is left, to which the receiver sets its own state. There are no acknowledgements.

Two properties of the firmware cost throughput. The number of bytes that fit into the rest of a window is kept
in 8 bits, so a modem waits although there is room, or yields since a frame does not fit. The estimate of a
packet's duration is too long, so a receiver may leave the channel while the last packet of a window arrives.

Left out: AT commands, listen before talk (LBT_RSSI), Manchester code, encryption, temperature, transmissions
that fail in the transmitter, and the processor's time for other work than the Golay code.
"""

from enum import Enum
from math import exp
from typing import NamedTuple, Protocol

from netsim.model.event_queue import NEVER_NS
from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.hopping import Hopping
from netsim.serial_radio.packets import PacketSource
from netsim.serial_radio.serial_ports import BITS_PER_BYTE, SerialInput, SerialOutput
from netsim.serial_radio.timing import (
    LEAST_XMIT_BYTES,
    LINK_UPDATE_TICKS,
    PREAMBLE_BYTES,
    PREAMBLE_DETECTION_BITS,
    STATISTICS_BYTES,
    TICK_NS,
    TRAILER_BYTES,
    Timing,
)

UNLOCKED_UPDATES, UNLOCKED_AGAIN, FORGOTTEN_UPDATES = 40, 5, 5
"""Link updates without a packet after which a modem scans, from where it counts again, and after which it
forgets the other end's statistics."""
MOST_ERRORS = 0xFFFF
STATUS_BYTES = {1: 17, 2: 21}
"""Length of RADIO_STATUS by MAVLink version."""


class State(Enum):
    """States of a modem, in their order."""

    TRANSMIT = 0
    SILENCE_AFTER_TRANSMIT = 1
    RECEIVE = 2
    SILENCE_AFTER_RECEIVE = 3


FOLLOWING = dict(zip(State, (*tuple(State)[1:], State.TRANSMIT), strict=True))
"""The state after each."""


class RadioStatus(NamedTuple):
    """Fields of MAVLink's RADIO_STATUS (109), as a modem reports them to its host."""

    rssi: int
    """Strength of received packets, in the units of `netsim.serial_radio.errors.rssi`."""
    remrssi: int
    """The same at the other end, as last received from it."""
    txbuf: int
    """Free space of the buffer of bytes from the host, percent."""
    noise: int
    remnoise: int
    rxerrors: int
    """Packets that were detected and discarded, since the start."""
    fixed: int
    """Packets whose bit errors were corrected, since the start."""


class SentPacket(NamedTuple):
    """A packet on the air."""

    start_ns: int
    """Beginning of its preamble."""
    end_ns: int
    hop: int
    """Place of its channel in the sequence."""
    data: bytes
    window: int
    """Ticks left of the sender's window; 0: statistics."""
    bonus: bool
    """Whether it is sent in the receiver's own window, which that has yielded."""
    resend: bool
    statistics: tuple[int, int] | None
    """Strength and noise at the sender."""
    data_bytes: int
    """Bytes between header and CRC, trailer included."""


class Modem:
    """State of one modem; all times in ns. `netsim.serial_radio.links` calls `step` at `next_ns`."""

    def __init__(self, config: SerialRadioConfig, timing: Timing, channels: int) -> None:
        self._timing = timing
        byte_ns = BITS_PER_BYTE * 1_000_000_000 // config.serial_rate_baud
        self.input = SerialInput(byte_ns, config.host_buffer_bytes)
        self.output = SerialOutput(byte_ns)
        self.source = PacketSource(
            self.input,
            framing=config.mavlink_framing,
            resend=config.opportunistic_resend,
            max_frame_bytes=timing.max_frame_bytes,
            serial_rate_baud=config.serial_rate_baud,
        )
        self.hopping = Hopping(channels)
        self._duty_cycle = config.duty_cycle_percent
        self.state = State.TRANSMIT
        self._state_end_ns = NEVER_NS
        self._wait_ns = 0
        """Time before which no packet begins in the present state."""
        self._bonus = False
        """Whether the other end has yielded its window."""
        self._yielded = False
        self.sending: SentPacket | None = None
        self.receiving_since_ns = 0
        """Time from which the receiver has been on without interruption."""
        self._link_update_ns = 0
        self._received_packet = False
        self._unlocked = 0
        """Link updates since the last packet."""
        self._send_statistics = False
        self._last_rssi = 0
        self.average_rssi = 0
        self.average_noise = 0
        self.remote_rssi = 0
        self.remote_noise = 0
        self.rx_errors = 0
        self.corrected_packets = 0
        self._sent_ticks = 0
        self._average_duty = 0.0
        self._duty_wait = False
        self._last_received: bytes | None = None
        self._last_was_resend = False
        self.next_ns = NEVER_NS
        """Time of the next `step`."""
        rate_bits_ns = 8.0 / timing.byte_ns
        self._noise_preamble = 1.0 - exp(
            -(2.0 ** (1 - PREAMBLE_DETECTION_BITS)) * rate_bits_ns * LINK_UPDATE_TICKS * TICK_NS
        )
        """Probability that noise is taken for a preamble between two link updates."""

    def begin(self, phase_ticks: int, hop: int, link_update_ns: int) -> None:
        """Set the state at time 0, ``phase_ticks`` after the beginning of an own window, on channel ``hop``.

        The modem has received packets before; its first link update is at ``link_update_ns``.
        """
        state = State.TRANSMIT
        while phase_ticks >= self._duration(state):
            phase_ticks -= self._duration(state)
            state = FOLLOWING[state]
        self.state = state
        self._state_end_ns = (self._duration(state) - phase_ticks) * TICK_NS
        self._link_update_ns = link_update_ns
        self.hopping.transmit = self.hopping.receive = (
            hop + (state is not State.TRANSMIT)
        ) % self.hopping.count
        self._plan(0)

    def _duration(self, state: State) -> int:
        window = state is State.TRANSMIT or state is State.RECEIVE
        return self._timing.window if window else self._timing.silence

    def _may_send(self) -> bool:
        """Whether the present state allows packets."""
        if self.state is not State.TRANSMIT and not (self._bonus and self.state is State.RECEIVE):
            return False
        return not (self._yielded or self._duty_wait)

    def _plan(self, at_ns: int) -> None:
        """Set the time of the next step."""
        if self.sending is not None:
            self.next_ns = self.sending.end_ns
            return
        self.next_ns = min(self._state_end_ns, self._link_update_ns)
        if self._may_send():
            self.next_ns = min(self.next_ns, max(at_ns, self._wait_ns))

    def step(self, at_ns: int, environment: "Environment") -> None:
        """Do what is due at `next_ns`, which is ``at_ns``. A packet that begins is then in `sending`."""
        if self.sending is not None:
            # the processor was busy with the transmission
            self.sending = None
            self.receiving_since_ns = at_ns
        if at_ns >= self._link_update_ns:
            self._update_link(at_ns, environment)
        while at_ns >= self._state_end_ns:
            self._next_state(at_ns)
        if self._may_send() and at_ns >= self._wait_ns:
            self._send(at_ns, environment)
        self._plan(at_ns)

    def _next_state(self, at_ns: int) -> None:
        state = self.state = FOLLOWING[self.state]
        self._state_end_ns += self._duration(state) * TICK_NS
        if state is State.TRANSMIT or state is State.SILENCE_AFTER_TRANSMIT:
            self.hopping.window_change()
            self.receiving_since_ns = at_ns
        if state is State.TRANSMIT and self._duty_cycle != 100:
            duty_percent = 100.0 * self._sent_ticks / (2 * (self._timing.silence + self._timing.window))
            self._average_duty = 0.95 * self._average_duty + 0.05 * duty_percent
            self._sent_ticks = 0
            self._duty_wait = self._average_duty >= self._duty_cycle
        self._bonus = self._yielded = False
        self._wait_ns = 0

    def _update_link(self, at_ns: int, environment: "Environment") -> None:
        """Evaluate the link, every 0.51 s (`link_update`)."""
        self._link_update_ns = at_ns + LINK_UPDATE_TICKS * TICK_NS
        self._send_statistics = True
        if self._received_packet:
            self._received_packet, self._unlocked = False, 0
            return
        self._unlocked += 1
        if environment.uniform() < self._noise_preamble:
            self._last_rssi = environment.noise_rssi(at_ns)
        if self._unlocked > UNLOCKED_UPDATES:
            self._unlocked = UNLOCKED_AGAIN
            if environment.uniform() < 0.5:
                # another phase, as both ends may send at the same times
                left = (self._state_end_ns - at_ns) // TICK_NS
                earlier = self._timing.packet_latency if left > self._timing.silence else max(left - 1, 0)
                self._state_end_ns -= earlier * TICK_NS
            self.hopping.scan()
            self.receiving_since_ns = at_ns
        self.average_rssi = (self._last_rssi + 3 * self.average_rssi) // 4
        if self._unlocked > FORGOTTEN_UPDATES:
            self.remote_rssi = self.remote_noise = 0

    def _send(self, at_ns: int, environment: "Environment") -> None:
        """Begin a packet, or set the time before which none can begin."""
        incoming_until_ns = environment.incoming_until_ns(at_ns)
        if incoming_until_ns:
            # the preamble of a packet was detected
            self._wait_ns = incoming_until_ns + self._timing.packet_latency * TICK_NS
            return
        noise = environment.noise_rssi(at_ns)
        self.average_noise = (noise + 3 * self.average_noise) // 4 if self.average_noise else noise
        timing = self._timing
        left = (self._state_end_ns - at_ns) // TICK_NS
        fitting = (left - timing.packet_latency) // timing.ticks_per_byte
        most_bytes = fitting & 0xFF
        if fitting < LEAST_XMIT_BYTES:
            self._wait_ns = self._state_end_ns
            return
        if most_bytes < LEAST_XMIT_BYTES:
            # until the number of 8 bits has wrapped to 255
            wrapped = timing.packet_latency + (fitting & ~0xFF) * timing.ticks_per_byte - 1
            self._wait_ns = self._state_end_ns - wrapped * TICK_NS
            return
        most_bytes = min(most_bytes - TRAILER_BYTES - 1, timing.max_payload_bytes)
        data = self.source.next(most_bytes, at_ns)
        statistics: tuple[int, int] | None = None
        data_bytes = len(data) + TRAILER_BYTES
        own = self.state is State.TRANSMIT
        if own and not data and self._send_statistics and most_bytes >= STATISTICS_BYTES:
            self._send_statistics = False
            statistics = self.average_rssi, self.average_noise
            data_bytes += STATISTICS_BYTES
        elif not data:
            self._yielded = True
        estimate = timing.estimate(data_bytes)
        self._sent_ticks += estimate
        self._wait_ns = at_ns + timing.packet_latency * TICK_NS
        start_ns = at_ns + timing.before_ns(data_bytes)
        self.sending = SentPacket(
            start_ns=start_ns,
            end_ns=start_ns + timing.air_bytes(data_bytes) * timing.byte_ns,
            hop=self.hopping.transmit,
            data=data,
            window=0 if statistics is not None else left - estimate,
            bonus=not own,
            resend=self.source.is_resend and statistics is None,
            statistics=statistics,
            data_bytes=data_bytes,
        )

    def can_receive(self, packet: SentPacket) -> bool:
        """Whether the receiver is on the packet's channel, and has been since early in the preamble."""
        bits = 8 * PREAMBLE_BYTES - PREAMBLE_DETECTION_BITS
        latest_ns = packet.start_ns + bits * self._timing.byte_ns // 8
        return (
            self.sending is None
            and self.receiving_since_ns <= latest_ns
            and self.hopping.receive == packet.hop
        )

    def receive(
        self, packet: SentPacket, rssi: int, at_ns: int, *, corrected: bool
    ) -> list[tuple[int, bytes]]:
        """Accept a packet that ends at ``at_ns`` without errors left.

        Returns the pieces of its data, with the times at which they arrive at the host.
        """
        pieces: list[tuple[int, bytes]] = []
        self.receiving_since_ns = at_ns
        self._received_packet = True
        self.hopping.lock()
        self._last_rssi = rssi
        self.average_rssi = (rssi + 7 * self.average_rssi) // 8 if self.average_rssi else rssi
        if corrected:
            self.corrected_packets = min(self.corrected_packets + 1, MOST_ERRORS)
        self._wait_ns = 0
        if packet.statistics is not None:
            self.remote_rssi, self.remote_noise = packet.statistics
        else:
            ready_ns = at_ns + self._timing.after_ns(packet.data_bytes)
            self._synchronise(packet, ready_ns)
            if packet.data and not self._is_duplicate(packet):
                pieces = self.output.write(packet.data, ready_ns)
        self._plan(at_ns)
        return pieces

    def reject(self, rssi: int, at_ns: int) -> None:
        """Discard a packet that ends at ``at_ns`` with errors."""
        self.receiving_since_ns = at_ns
        self._last_rssi = rssi
        self.rx_errors = min(self.rx_errors + 1, MOST_ERRORS)

    def _synchronise(self, packet: SentPacket, at_ns: int) -> None:
        """Follow the sender's window (`sync_tx_windows`)."""
        left = packet.window
        if not packet.bonus:
            self.state = State.RECEIVE
        elif self.state is State.SILENCE_AFTER_TRANSMIT:
            left = self._timing.silence
        elif self.state is State.TRANSMIT:
            pass
        else:
            self.state, left = State.SILENCE_AFTER_RECEIVE, 1
        self._state_end_ns = at_ns + left * TICK_NS
        # an empty packet in the sender's own window yields the rest of it
        self._bonus = self.state is State.RECEIVE and not packet.data
        if self.state is not State.TRANSMIT:
            self._yielded = False

    def _is_duplicate(self, packet: SentPacket) -> bool:
        """Whether a repeated packet has been received before."""
        if not packet.resend:
            self._last_received, self._last_was_resend = packet.data, False
            return False
        if not self._last_was_resend and packet.data == self._last_received:
            return True
        self._last_was_resend = True
        return False

    def take_status(self, at_ns: int) -> tuple[int, RadioStatus] | None:
        """Return the arrival at the host and the fields of a RADIO_STATUS that is due, or None.

        One is due after the transmission of a HEARTBEAT, when the buffer has space for it (`MAVLink_report`).
        """
        version = self.source.heartbeat_version
        if version == 0 or self.output.space(at_ns) < STATUS_BYTES[version]:
            return None
        self.source.heartbeat_version = 0
        self.input.absorb(at_ns)
        status = RadioStatus(
            rssi=self.average_rssi,
            remrssi=self.remote_rssi,
            txbuf=self.input.free_percent,
            noise=self.average_noise,
            remnoise=self.remote_noise,
            rxerrors=self.rx_errors,
            fixed=self.corrected_packets,
        )
        return self.output.occupy(STATUS_BYTES[version], at_ns), status


class Environment(Protocol):
    """What a modem receives from outside, except packets."""

    def uniform(self) -> float:
        """Return a random number in [0, 1)."""

    def noise_rssi(self, at_ns: int) -> int:
        """Return the present strength of noise and interference on the modem's channel."""

    def incoming_until_ns(self, at_ns: int) -> int:
        """Return the end of a packet whose preamble the modem has detected, or 0."""

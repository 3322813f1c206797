"""Times of the firmware's time-division multiplexing, and times on the air.

Facts of Firmware/radio/tdm.c (`tdm_init`, `flight_time_estimate`), timer.c and radio_443x.c of ArduPilot/SiK,
revision 50189f2. Windows and estimates are counted in ticks, which the firmware calls 16 us. A tick is 32
periods of SYSCLK / 12 at SYSCLK = 24.5 MHz, 15.67 us. Both modems of a pair have equal clocks here; the real
ones differ by up to 2 %, which each packet's trailer corrects.

The ends alternate: a transmit window, a silence, the other end's window, a silence. The estimate of a
packet's duration is longer than the packet, so windows end a little earlier at the receiver.
"""

from msgspec import Struct

from netsim.serial_radio.config import SerialRadioConfig

TICK_NS = 15_673
"""Duration of a tick."""
MAX_PACKET_BYTES = 252
"""Most bytes between header and CRC (MAX_PACKET_LENGTH); with ECC after encoding."""
TRAILER_BYTES = 2
"""Window in 13 bits, three flags."""
STATISTICS_BYTES = 4
LEAST_XMIT_BYTES = TRAILER_BYTES + 16
"""A modem starts no packet if fewer bytes fit into the rest of the window (PACKET_OVERHEAD)."""
PREAMBLE_BYTES = 8
PREAMBLE_DETECTION_BITS = 20
SYNC_BYTES, HEADER_BYTES, LENGTH_BYTES, CRC_BYTES = 2, 2, 1, 2
"""Of the packet handler. With ECC there is no header and no CRC: NETID, CRC and length are encoded."""
ECC_OVERHEAD_BYTES = 6
"""NETID, length, CRC, length: before encoding, which doubles them."""
TURNAROUND_NS = 200_000
"""From the decision to send to the first bit (Si1000 data sheet, response time from RX to TX state)."""
ENCODE_NS, DECODE_NS = 6_000, 4_000
"""Processor time of the Golay code, per byte before encoding and per encoded byte (golay.c)."""
LINK_UPDATE_TICKS = 32_768
"""Interval at which a modem evaluates its link."""
_WINDOW_FIELD = 0x1FFF
_REGULATORY_WINDOW_TICKS = 25_000
"""0.4 s, the longest window with frequency hopping."""
_TICKS_PER_MS = 62


class Timing(Struct, frozen=True, kw_only=True):
    """Durations in ticks that follow from the settings, and packet sizes in bytes."""

    ticks_per_byte: int
    packet_latency: int
    """Estimate of an empty packet's overhead, from which the estimate of every packet begins."""
    silence: int
    window: int
    max_payload_bytes: int
    """Most bytes of serial data in a packet."""
    max_frame_bytes: int
    """Limit by which the firmware determines whether it can frame a MAVLink packet."""
    byte_ns: int
    """Duration of a byte on the air."""
    ecc: bool

    @property
    def round_ns(self) -> int:
        """Period of the windows of both ends."""
        return 2 * (self.window + self.silence) * TICK_NS

    def estimate(self, data_bytes: int) -> int:
        """Return the firmware's estimate of a packet's duration in ticks, with its trailer as data."""
        return self.packet_latency + data_bytes * self.ticks_per_byte

    def air_bytes(self, data_bytes: int) -> int:
        """Return the bytes on the air of a packet, preamble included; ``data_bytes`` include the trailer."""
        if self.ecc:
            return PREAMBLE_BYTES + SYNC_BYTES + LENGTH_BYTES + self.encoded_bytes(data_bytes)
        return PREAMBLE_BYTES + SYNC_BYTES + HEADER_BYTES + LENGTH_BYTES + data_bytes + CRC_BYTES

    def encoded_bytes(self, data_bytes: int) -> int:
        """Return the encoded bytes of a packet with ECC."""
        return 2 * ((data_bytes + 2) // 3 * 3 + ECC_OVERHEAD_BYTES)

    def before_ns(self, data_bytes: int) -> int:
        """Return the time from the decision to send to the first bit."""
        return TURNAROUND_NS + (ENCODE_NS * self.encoded_bytes(data_bytes) // 2 if self.ecc else 0)

    def after_ns(self, data_bytes: int) -> int:
        """Return the time from the last bit to the evaluation of the packet."""
        return DECODE_NS * self.encoded_bytes(data_bytes) if self.ecc else 0


def make_timing(config: SerialRadioConfig, channels: int) -> Timing:
    """Return the times that the firmware computes at its start (`tdm_init`), for a number of channels.

    Raises ValueError if no packet fits into a window.
    """
    # the division rounds to nearest, and one more tick is added
    ticks_per_byte = (8 + 8_000 // config.air_rate_kbps) // 16 + 1
    # for a preamble of 5 bytes, whatever the real one is
    packet_latency = (8 + 5) * ticks_per_byte + 13
    if config.ecc:
        max_payload_bytes = MAX_PACKET_BYTES // 2 - (ECC_OVERHEAD_BYTES + TRAILER_BYTES)
        ticks_per_byte *= 2
        packet_latency += 4 * ticks_per_byte
    else:
        max_payload_bytes = MAX_PACKET_BYTES - TRAILER_BYTES
    silence = 2 * packet_latency
    window = 3 * (packet_latency + max_payload_bytes * ticks_per_byte)
    if channels > 1:
        window = min(window, _REGULATORY_WINDOW_TICKS)
    window = min(window, config.max_window_ms * _TICKS_PER_MS, _WINDOW_FIELD)
    # the real preamble has 16 nibbles
    packet_latency += 3 * ticks_per_byte
    least = packet_latency + LEAST_XMIT_BYTES * ticks_per_byte
    if window < least:
        raise ValueError(
            f"serial_radio.max_window_ms: no packet fits into {config.max_window_ms} ms at "
            f"{config.air_rate_kbps} kbit/s; expected at least {-(-least // _TICKS_PER_MS)}, "
            "or a higher air_rate_kbps"
        )
    return Timing(
        ticks_per_byte=ticks_per_byte,
        packet_latency=packet_latency,
        silence=silence,
        window=window,
        max_payload_bytes=max_payload_bytes,
        max_frame_bytes=min((window - packet_latency) // ticks_per_byte, max_payload_bytes),
        byte_ns=round(8e6 / config.air_rate_kbps),
        ecc=config.ecc,
    )

"""Frames of two-way ranging and their durations in the HRP UWB PHY.

Source: IEEE 802.15.4-2020, clause 15: preamble and SFD symbols (15.2.6), PHY header (15.2.7), Reed-Solomon
code RS(63, 55) over 6-bit symbols with 48 parity bits a block of 330 bits (15.3.3.2). The PHY header has 19
bits and takes 21 symbols with the tail of the convolutional code (DW1000 user manual 2.12, and the maker's
calculation of message times). Results agree with the DW1000 data sheet: 175 us for 12 bytes at 6.8 Mbit/s,
128 preamble symbols and 16 MHz.
"""

from enum import IntEnum

from netsim.uwb.config import DataRateKbps, PrfMhz, UwbConfig

CHIP_MHZ = 499.2
"""Peak pulse repetition frequency, and bandwidth of the channels 5 and 9."""
CENTRE_MHZ = {5: 6489.6, 9: 7987.2}
"""By channel."""
_PREAMBLE_CHIPS: dict[PrfMhz, int] = {16: 31 * 16, 64: 127 * 4}
"""Code length times spreading of a preamble symbol: 993.6 and 1017.6 ns."""
_DATA_CHIPS: dict[DataRateKbps, int] = {850: 512, 6810: 64}
"""Chips of a data symbol, which carries one bit before the convolutional code: 1025.6 and 128.2 ns."""
SFD_SYMBOLS = 8
HEADER_SYMBOLS = 21
HEADER_CHIPS = 512
"""The header is sent at 850 kbit/s with either data rate."""
RS_INFORMATION_BITS, RS_PARITY_BITS = 330, 48
_OVERHEAD_BYTES = 12
"""Frame control, sequence number, PAN, two short addresses, function code, FCS."""
_STAMP_BYTES = 4


class UwbFrame(IntEnum):
    """Kinds of frames."""

    POLL = 0
    RESPONSE = 1
    FINAL = 2
    REPORT = 3


FRAME_BYTES: dict[UwbFrame, int] = {
    UwbFrame.POLL: _OVERHEAD_BYTES,
    UwbFrame.RESPONSE: _OVERHEAD_BYTES + 2 * _STAMP_BYTES,  # arrival of the poll, own departure
    UwbFrame.FINAL: _OVERHEAD_BYTES
    + 3 * _STAMP_BYTES,  # departures of poll and final, arrival of the response
    UwbFrame.REPORT: _OVERHEAD_BYTES + _STAMP_BYTES,  # time of flight
}


def preamble_symbol_us(prf_mhz: PrfMhz) -> float:
    """Return the duration of a symbol of preamble and SFD."""
    return _PREAMBLE_CHIPS[prf_mhz] / CHIP_MHZ


def data_symbol_us(data_rate_kbps: DataRateKbps) -> float:
    """Return the duration of a data symbol."""
    return _DATA_CHIPS[data_rate_kbps] / CHIP_MHZ


def coded_bits(payload_bytes: int) -> int:
    """Return the number of bits of a payload with its Reed-Solomon parity."""
    bits = 8 * payload_bytes
    return bits + RS_PARITY_BITS * -(-bits // RS_INFORMATION_BITS)


def to_marker_us(config: UwbConfig) -> float:
    """Return the time from a frame's beginning to its marker, the first pulse of the PHY header.

    Time stamps refer to the marker.
    """
    return (config.preamble_symbols + SFD_SYMBOLS) * preamble_symbol_us(config.prf_mhz)


def after_marker_us(config: UwbConfig, payload_bytes: int) -> float:
    """Return the time from a frame's marker to its end: PHY header and payload of 0 to 127 bytes."""
    payload_us = coded_bits(payload_bytes) * data_symbol_us(config.data_rate_kbps)
    return HEADER_SYMBOLS * HEADER_CHIPS / CHIP_MHZ + payload_us


def duration_us(config: UwbConfig, payload_bytes: int) -> float:
    """Return the air time of a frame whose payload, FCS included, has 0 to 127 bytes."""
    return to_marker_us(config) + after_marker_us(config, payload_bytes)


def frames_of(config: UwbConfig) -> tuple[UwbFrame, ...]:
    """Return the frames of an exchange in their order."""
    return tuple(UwbFrame)[: 2 if config.method == "ss" else 4]


def exchange_us(config: UwbConfig) -> float:
    """Return the time from the beginning of an exchange to the end of its last frame, without propagation."""
    frames = frames_of(config)
    between_us = (len(frames) - 1) * config.reply_time_us
    return to_marker_us(config) + between_us + after_marker_us(config, FRAME_BYTES[frames[-1]])


def airtime_us(config: UwbConfig) -> float:
    """Return the sum of the air times of an exchange's frames."""
    return sum(duration_us(config, FRAME_BYTES[frame]) for frame in frames_of(config))


def slot_us(config: UwbConfig) -> float:
    """Return the length of a slot."""
    return config.slot_guard_us + exchange_us(config) if config.slot_us is None else float(config.slot_us)


def check(config: UwbConfig) -> None:
    """Raise ValueError, with the field below ``uwb``, for times in which frames do not fit."""
    turn_us = max(after_marker_us(config, FRAME_BYTES[each]) for each in frames_of(config)) + to_marker_us(
        config
    )
    if config.reply_time_us <= turn_us:
        raise ValueError(
            f"reply_time_us: {config.reply_time_us} us; a frame after its marker and the reply before its "
            f"marker take {turn_us:.0f} us; expected more"
        )
    least_us = config.slot_guard_us + exchange_us(config)
    if config.access == "slots" and slot_us(config) < least_us:
        raise ValueError(
            f"slot_us: {config.slot_us} us; guard time and exchange take {least_us:.0f} us; "
            "expected at least that"
        )

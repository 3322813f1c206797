"""Channels and frequency hopping of the firmware.

Facts of Firmware/radio/freq_hopping.c and main.c (`radio_init`) of ArduPilot/SiK, revision 50189f2. The order
of the channels and an offset of the frequencies follow from the NETID. Both ends hop when one of their own
windows begins or ends. An end that has received nothing for 20 s scans: its receive channel changes only
when the sequence of its transmit channels starts again, until it receives a packet.
"""

from msgspec import Struct

from netsim.serial_radio.config import SerialRadioConfig

BANDS = {
    433: (433_050_000, 434_790_000, 10),
    868: (868_000_000, 870_000_000, 10),
    915: (915_000_000, 928_000_000, 50),
}
"""Lowest and highest frequency in Hz and number of channels, by band in MHz."""
DEVIATION_HZ = {
    4: 3_750, 8: 8_125, 16: 16_250, 19: 18_750, 24: 23_750, 32: 31_875,
    48: 48_125, 64: 63_750, 96: 96_250, 128: 128_125, 192: 158_750, 250: 158_750,
}  # fmt: skip
"""Frequency deviation by air rate in kbit/s (register tables of radio_443x.c)."""


def occupied_hz(air_rate_kbps: int) -> float:
    """Return the bandwidth of a signal and of the receiver's filter, by Carson's rule."""
    return 2.0 * DEVIATION_HZ[air_rate_kbps] + 1e3 * air_rate_kbps


def channel_count(config: SerialRadioConfig) -> int:
    """Return the number of channels."""
    return BANDS[config.band_mhz][2] if config.channels is None else config.channels


def centre_mhz(config: SerialRadioConfig) -> float:
    """Return the middle of the band, at which path losses are computed."""
    low_hz, high_hz, _ = BANDS[config.band_mhz]
    return (low_hz + high_hz) / 2e6


def span_mhz(config: SerialRadioConfig) -> float:
    """Return the width of the band, over which path losses are averaged."""
    low_hz, high_hz, _ = BANDS[config.band_mhz]
    return (high_hz - low_hz) / 1e6


class _Random:
    """Generator of the firmware, by which both ends derive the same sequence."""

    def __init__(self, seed: int) -> None:
        self._state = seed

    def next(self) -> int:
        self._state = (self._state * 1_103_515_245 + 12_345) & 0xFFFF_FFFF
        return (self._state >> 16) & 0x7FFF


def frequencies_hz(config: SerialRadioConfig, net_id: int) -> tuple[int, ...]:
    """Return the frequencies of a network in the order of its hops."""
    low_hz, high_hz, _ = BANDS[config.band_mhz]
    count = channel_count(config)
    spacing_hz = (high_hz - low_hz) // (count + 2)
    first_hz = low_hz + spacing_hz // 2
    if count > 5:
        # an int of 16 bits, extended with its sign
        product = _Random(net_id).next() * 625 & 0xFFFF
        first_hz += (product - 0x1_0000 + 0x1_0000_0000 if product & 0x8000 else product) % spacing_hz
    # the register of the spacing has units of 10 kHz
    step_hz = (spacing_hz + 5_000) // 10_000 * 10_000
    order = list(range(count))
    random = _Random(net_id)
    for i in range(count - 1):
        j = (random.next() & 0xFF) % count
        order[i], order[j] = order[j], order[i]
    return tuple(first_hz + channel * step_hz for channel in order)


class Hopping(Struct):
    """Place of one modem in the sequence of channels."""

    count: int
    transmit: int = 0
    receive: int = 0
    locked: bool = True

    def window_change(self) -> None:
        """Hop at the beginning or the end of an own window."""
        self.transmit = (self.transmit + 1) % self.count
        if self.locked:
            self.receive = self.transmit
        elif self.transmit == 0:
            self.receive = (self.receive + 1) % self.count

    def lock(self) -> None:
        """Follow the sequence from the channel on which a packet was received."""
        self.locked, self.transmit = True, self.receive

    def scan(self) -> None:
        """Listen on the next channel until a packet arrives."""
        self.locked, self.receive = False, (self.receive + 1) % self.count

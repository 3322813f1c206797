"""Times of the serial radio against hand calculations with the firmware's formulas."""

import pytest

from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.hopping import BANDS, DEVIATION_HZ, frequencies_hz, occupied_hz
from netsim.serial_radio.timing import TICK_NS, make_timing

RATES = tuple(DEVIATION_HZ)


def test_default_rate():
    """(8 + 125) / 16 + 1 = 9 ticks per byte, latency 13 * 9 + 13 + 3 * 9, window of 3 full packets."""
    timing = make_timing(SerialRadioConfig(), 50)
    assert timing.ticks_per_byte == 9
    assert timing.packet_latency == 157
    assert timing.silence == 2 * 130
    assert timing.window == 3 * (130 + 250 * 9)
    assert timing.max_payload_bytes == timing.max_frame_bytes == 250
    assert timing.air_bytes(2) == 8 + 2 + 2 + 1 + 2 + 2
    assert timing.air_bytes(252) * timing.byte_ns == 267 * 125_000


def test_ecc_doubles_bytes():
    timing = make_timing(SerialRadioConfig(ecc=True), 50)
    assert timing.ticks_per_byte == 18
    assert timing.silence == 2 * (130 + 4 * 18)
    assert timing.max_payload_bytes == 118
    # 120 bytes in threes, NETID, CRC and two lengths, each twice
    assert timing.air_bytes(120) == 8 + 2 + 1 + 252
    assert timing.air_bytes(2) == 8 + 2 + 1 + 18


def test_slow_rates_are_limited_by_the_longest_window():
    """At 4 kbit/s the window of 131 units of 62 ticks holds 48 bytes, of which 45 are data."""
    timing = make_timing(SerialRadioConfig(air_rate_kbps=4), 50)
    assert timing.window == 131 * 62
    assert timing.max_frame_bytes == (8122 - timing.packet_latency) // 126 == 48
    shorter = make_timing(SerialRadioConfig(max_window_ms=33), 50)
    assert shorter.window == 33 * 62


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("ecc", [False, True])
def test_estimates_are_longer_than_packets(rate, ecc):
    """At least with the silence after the window; otherwise windows of both ends would overlap."""
    timing = make_timing(SerialRadioConfig(air_rate_kbps=rate, ecc=ecc), 50)
    for data_bytes in (2, timing.max_frame_bytes):
        real_ns = timing.before_ns(data_bytes) + timing.air_bytes(data_bytes) * timing.byte_ns
        assert (timing.estimate(data_bytes) + timing.silence) * TICK_NS > real_ns


def test_a_window_too_short_for_packets_is_one_line():
    with pytest.raises(
        ValueError, match=r"^serial_radio.max_window_ms: .* expected at least 70, or"
    ) as caught:
        make_timing(SerialRadioConfig(air_rate_kbps=4, max_window_ms=33), 50)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("band", BANDS)
def test_channels_are_in_the_band_and_differ(band):
    low_hz, high_hz, count = BANDS[band]
    config = SerialRadioConfig(band_mhz=band)
    first, second = frequencies_hz(config, 25), frequencies_hz(config, 26)
    assert len(set(first)) == count
    assert first != second
    assert all(low_hz < frequency < high_hz for frequency in first + second)


def test_bandwidth_by_carsons_rule():
    assert occupied_hz(64) == 2 * 63_750 + 64_000

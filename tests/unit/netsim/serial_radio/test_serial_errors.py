"""Bit and packet errors of the serial radio against the data sheet and closed forms."""

from math import comb, exp, log10

import numpy as np
import pytest
from serial_pairs import GROUND, VEHICLE, Pairs, mavlink_frame

from netsim.model.config import RadioConfig
from netsim.phy.path_loss import friis_loss_db
from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.errors import PacketErrors, noise_mw, rssi, sensitivity_dbm
from netsim.serial_radio.gains import PathGains
from netsim.serial_radio.links import SerialLinks
from netsim.serial_radio.timing import make_timing

N0_DBM_HZ = 10.0 * log10(1.380649e-23 * 290.0 * 1e3)
FRAME_BYTES = 80


def bit_error_rate(power_dbm, rate_kbps=64, losses_db=9.0):
    """Of ideal non-coherent FSK with noise figure and implementation loss."""
    eb_n0_db = power_dbm - N0_DBM_HZ - losses_db - 10.0 * log10(1e3 * rate_kbps)
    return 0.5 * exp(-0.5 * 10.0 ** (eb_n0_db / 10.0))


def chance(rate, data_bytes, *, ecc):
    """That a packet is received, trailer included in ``data_bytes``."""
    right = 1.0 - rate
    if not ecc:
        return right ** (8 * (2 + 2 + 1 + data_bytes + 2))
    words = 2 * (-(-data_bytes // 3) * 3 + 6) // 3
    word = sum(comb(23, k) * rate**k * right ** (23 - k) for k in range(4))
    return right ** (8 * (2 + 1)) * word**words


@pytest.mark.parametrize(("rate", "dbm"), [(4, -118.0), (96, -104.2), (128, -100.9)])
def test_sensitivity_is_that_of_the_data_sheet(rate, dbm):
    """-121 dBm at 2 kbit/s, -104 at 100, -101 at 125; +3, -0.2 and +0.1 dB for the rates here."""
    config = SerialRadioConfig(air_rate_kbps=rate)
    assert sensitivity_dbm(config) == pytest.approx(dbm, abs=0.25)
    errors = PacketErrors(config, make_timing(config, 50))
    assert errors.bit_error_rate(10.0 ** (sensitivity_dbm(config) / 10.0)) == pytest.approx(1e-3, rel=1e-6)


def test_units_of_strength():
    assert rssi(10.0 ** (-60.0 / 10.0)) == round(1.9 * 67)
    assert rssi(0.0) == 0
    assert rssi(1e6) == 255
    # thermal noise in 191.5 kHz with 7 dB: -114.2 dBm
    assert rssi(noise_mw(SerialRadioConfig())) == round(1.9 * (127.0 - 114.15))


@pytest.mark.parametrize("ecc", [False, True])
@pytest.mark.parametrize("received", [0.95, 0.5, 0.1])
def test_packet_loss_is_the_closed_form(ecc, received):
    """800 packets, each alone: the number of those received is binomial."""
    power_dbm = max(
        p
        for p in np.arange(-130.0, -90.0, 0.01)
        if chance(bit_error_rate(p), FRAME_BYTES + 2, ecc=ecc) < received
    )
    pairs = Pairs(gain=10.0 ** ((power_dbm - 20.0) / 10.0), ecc=ecc)
    count = 800
    frames = [(0.5 * i, VEHICLE, mavlink_frame(FRAME_BYTES, i)) for i in range(count)]
    delays = pairs.send(frames, 0.5 * count + 1.0)
    sent = pairs.links.counters(VEHICLE)
    got = pairs.links.counters(GROUND)
    assert sent.packets_sent == count
    assert len(delays) == got.packets_received
    deviation = (count * received * (1.0 - received)) ** 0.5
    assert abs(len(delays) - count * received) < 4.0 * deviation
    if ecc:
        assert got.packets_corrected > 0.9 * got.packets_received


def test_interference_raises_the_noise():
    config = SerialRadioConfig()
    errors = PacketErrors(config, make_timing(config, 50))
    noise = noise_mw(config)
    assert errors.bit_error_rate(noise, noise) == pytest.approx(errors.bit_error_rate(noise / 2.0))


def loss_at(distance_m, count, **radio):
    """Fraction of lost packets between stations at rest."""
    serial = SerialRadioConfig()
    settings = {"path_loss": "friis", "rician_k_db": None} | radio
    gains = PathGains(RadioConfig(**settings), serial, 2, np.random.SeedSequence(3))
    gains.set_motion(0, [(0.0, 0.0, -5.0), (distance_m, 0.0, -5.0)], np.zeros((2, 3)))
    links = SerialLinks(serial, [(0, 1)], gains, np.random.SeedSequence(4))
    for i in range(count):
        links.submit(VEHICLE, mavlink_frame(FRAME_BYTES, i), i * 500_000_000)
        links.run_until((i + 1) * 500_000_000)
    return 1.0 - len([each for each in links.take() if each.end == GROUND]) / count


def test_range_is_that_of_the_link_budget():
    """Half of the packets are lost where 20 dBm less free-space loss at 921.5 MHz give one half."""
    half_dbm = max(
        p
        for p in np.arange(-120.0, -95.0, 0.001)
        if chance(bit_error_rate(p), FRAME_BYTES + 2, ecc=False) < 0.5
    )
    distance_m = 10.0 ** ((20.0 - half_dbm - friis_loss_db(1.0, 921.5)) / 20.0)
    assert 40e3 < distance_m < 60e3
    count = 400
    assert loss_at(distance_m, count) == pytest.approx(0.5, abs=4.0 * 0.5 / count**0.5)
    # extra attenuation of 6.02 dB halves the range
    assert loss_at(distance_m / 2.0, count, extra_attenuation_db=20.0 * log10(2.0)) == pytest.approx(
        0.5, abs=0.1
    )
    assert loss_at(distance_m * 0.7, 100) < 0.02
    assert loss_at(distance_m * 1.3, 100) > 0.98


def test_fading_and_two_rays_are_those_of_the_scenario():
    """Deep fades lose packets at ranges without loss; the ground's ray cuts the range of low antennas."""
    assert loss_at(20e3, 100) == 0.0
    assert 0.05 < loss_at(20e3, 100, rician_k_db=-10.0, fading_doppler_hz=2.0) < 0.6
    # 40 lg d - 20 lg (5 m)^2: 132 dB at 10 km, where free space has 112 dB, and 120 dB at 5 km
    assert loss_at(10e3, 50, path_loss="two_ray") == 1.0
    assert loss_at(5e3, 50, path_loss="two_ray") == 0.0

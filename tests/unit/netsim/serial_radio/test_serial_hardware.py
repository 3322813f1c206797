"""The serial radio against measurements of two HM-TRP 433 radios at 64 kbit/s and 57600 baud.

They are stated in the pull requests 97 of ArduPilot/SiK and 28714 of PX4/PX4-Autopilot (2026). The radios had
ECC = 1 in firmware built without the Golay code: its times are used, and nothing is encoded.
"""

import pytest
from msgspec import structs
from serial_pairs import GROUND, VEHICLE, Pairs, mavlink_frame

from netsim.serial_radio import links as serial_links

SECONDS = 20.0


@pytest.fixture
def without_code(monkeypatch):
    """The times of ECC, without encoding."""
    make = serial_links.make_timing
    monkeypatch.setattr(
        serial_links,
        "make_timing",
        lambda config, channels: structs.replace(make(config, channels), ecc=False),
    )


def loss(size, rate, **settings):
    """Fraction of frames of ``size`` bytes that do not arrive, at ``rate`` bytes/s in one direction."""
    pairs = Pairs(band_mhz=433, **settings)
    count = int(SECONDS * rate / size)
    frames = [mavlink_frame(size, i) for i in range(count)]
    pairs.send([(i * size / rate, VEHICLE, frame) for i, frame in enumerate(frames)], SECONDS + 3.0)
    stream = pairs.received(GROUND)
    return 1.0 - sum(frame in stream for frame in frames) / count


@pytest.mark.usefixtures("without_code")
@pytest.mark.parametrize(
    ("rate", "measured"),
    [(1_000, 0.0), (1_200, 0.109), (1_600, 0.272), (2_000, 0.444), (2_400, 0.522), (3_200, 0.633)],
)
def test_frames_of_105_bytes(rate, measured):
    """A second frame does not fit behind the first one, as the free bytes are kept in 8 bits."""
    assert loss(105, rate, ecc=True) == pytest.approx(measured, abs=0.06)


@pytest.mark.usefixtures("without_code")
@pytest.mark.parametrize("rate", [1_000, 1_600, 2_000, 2_400])
def test_frames_of_118_bytes_are_not_framed(rate):
    """They are too large for framing, so they fill the windows; none was lost."""
    assert loss(118, rate, ecc=True) == 0.0


@pytest.mark.usefixtures("without_code")
def test_telemetry_with_ecc_carries_about_2000_bytes_per_second():
    pairs = Pairs(ecc=True)
    sizes = (28, 30, 40, 20, 60, 44)
    frames, at_s = [], 0.0
    for i in range(1_800):
        frames.append((at_s, VEHICLE, mavlink_frame(sizes[i % len(sizes)], i)))
        at_s += sizes[i % len(sizes)] / 3_000.0
    pairs.send(frames, at_s)
    assert len(pairs.received(GROUND)) / at_s == pytest.approx(2_000.0, rel=0.15)

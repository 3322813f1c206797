"""Periodic broadcasts that contend, against ns-3's runs of the same. The file runs in about 2 s.

300 bytes of UDP at 6 Mbit/s are a frame of 512 us. ns-3 waits DIFS before it uses an idle medium, which the
standard does not ask for: its delays are up to 34 us longer.
"""

import numpy as np
import pytest
from netsim_air import Air

PERIOD_US = 100_000
FRAME_BYTES = 300 + 8 + 20 + 8 + 24 + 4
"""UDP, IPv4, LLC/SNAP, MAC header and FCS around the payload."""


def broadcast(stations, jitter_us, periods, seed=1):
    """Delivery ratio, and mean delay in ms of what was delivered, if all tick together but for a jitter."""
    rng = np.random.default_rng(seed)
    air = Air(stations, seed=seed, control_mode="ofdm6")
    jobs = []
    for k in range(periods):
        for station in range(stations):
            at_us = 1_000 + k * PERIOD_US + int(rng.uniform(0, jitter_us))
            jobs.append((at_us, station, air.send(at_us, station, frame_bytes=FRAME_BYTES)))
    air.queue.run_until(1_000 * (periods + 1) * PERIOD_US)
    sent = {(frame.source, frame.frame.sequence): frame for frame in air.transmissions}
    delays_ms = [
        (sent[source, job.sequence].end_ns - 1_000 * at_us) / 1e6
        for at_us, source, job in jobs
        for _ in sent[source, job.sequence].delivered
    ]
    return len(delays_ms) / (len(jobs) * (stations - 1)), float(np.mean(delays_ms))


@pytest.mark.parametrize(
    ("stations", "jitter_us", "ns3_ratio", "ns3_delay_ms"),
    [
        (2, 10_000, 0.998333, 0.561323),
        (4, 500, 0.872917, 1.21526),
        (8, 2_000, 0.804375, 1.57249),
        (16, 500, 0.417187, 3.09083),
        (16, 10_000, 0.908021, 1.10474),
        (32, 2_000, 0.231979, 3.56859),
    ],
)
def test_delivery_and_delay_match_ns3(stations, jitter_us, ns3_ratio, ns3_delay_ms):
    ratio, delay_ms = broadcast(stations, jitter_us, periods=6_000 // stations)
    assert ratio == pytest.approx(ns3_ratio, abs=0.03)
    assert delay_ms == pytest.approx(ns3_delay_ms, rel=0.1)


def test_group_frame_is_reported_once_with_its_receivers():
    """One is out of reach, and one has its radio off; the others have it when its end has reached them."""
    unheard = {(0, 3): -200.0, (3, 0): -200.0}
    air = Air(5, powers_dbm=unheard, delays_ns={(0, 1): 1_000, (0, 2): 2_000})
    reported = []
    air.radios._on_datagram = reported.append
    air.stations[4].silence()
    job = air.send(1_000, 0)
    air.run(10_000)
    ((start_us, end_us, _, _),) = air.run()
    (received,) = reported
    assert (received.source, received.seq, received.body) == (0, job.seq, job.body)
    assert list(received.stations) == [1, 2]
    assert list(received.ends_ns) == [1_000 * end_us + 1_000, 1_000 * end_us + 2_000]
    assert received.powers_mw == pytest.approx((1e-5, 1e-5))
    assert end_us > start_us


def test_group_frame_without_receivers_is_not_reported():
    air = Air(2, powers_dbm={(0, 1): -200.0})
    air.send(1_000, 0)
    assert len(air.run(10_000)) == 1
    assert air.arrivals == []

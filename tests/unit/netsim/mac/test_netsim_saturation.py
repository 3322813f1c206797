"""Saturated stations against Bianchi's model and against ns-3. The file runs in about 8 s.

Bianchi's values are those of ns-3's own reference, corrected for finite windows; his stations never give a
frame up. ns-3's own runs (1000 bytes of UDP, control frames at 6 Mbit/s) do, after seven attempts or 500 ms
in the queue. Of fifty stations' frames most expire first, and that, unlike the retry limit, leaves the window
as large as it has become.
"""

import pytest
from netsim_air import Air

from netsim.mac.jobs import Job, JobOutcome
from netsim.phy.frames import FrameKind
from netsim.phy.modes import phy_mode

PAYLOAD_BYTES = 1500
OVERHEAD_BYTES = 8 + 28
"""LLC/SNAP, MAC header and FCS."""
UDP_BYTES = 20 + 8
FOR_EVER = 2**31


def throughput_mbps(
    stations,
    mode,
    *,
    seconds,
    payload_bytes=PAYLOAD_BYTES,
    frame_bytes=PAYLOAD_BYTES + OVERHEAD_BYTES,
    rts=False,
    control_mode="ofdm24",
    retry_limit=FOR_EVER,
    lifetime_ns=2**60,
):
    """Throughput to one sink after a fifth of a second; every station always has two frames."""
    sink = stations
    air = Air(stations + 1, control_mode=control_mode)
    delivered = 0

    def feed(station):
        def done(_job, outcome):
            nonlocal delivered
            delivered += outcome is JobOutcome.ACKNOWLEDGED
            feed(station)

        job = Job(
            kind=FrameKind.DATA,
            destination=sink,
            mode=phy_mode(mode, 20),
            frame_bytes=frame_bytes,
            expires_ns=air.queue.now_ns + lifetime_ns,
            retry_limit=retry_limit,
            done=done,
            rts=rts,
        )
        air.stations[station].enqueue("be", job)

    for station in range(stations):
        feed(station)
        feed(station)
    air.queue.run_until(200_000_000)
    delivered = 0
    air.queue.run_until(200_000_000 + round(seconds * 1e9))
    return delivered * payload_bytes * 8 / seconds / 1e6


def test_throughput_of_one_station_follows_from_the_timing():
    # DIFS 34 + 7.5 slots 67.5 + data 2072 + SIFS 16 + ACK 44 = 2233.5 us on average
    assert throughput_mbps(1, "ofdm6", seconds=2) == pytest.approx(12_000 / 2233.5, rel=0.005)


@pytest.mark.parametrize(
    ("stations", "mode", "bianchi_mbps"),
    [
        (5, "ofdm6", 4.7087),
        (20, "ofdm6", 3.9899),
        (50, "ofdm6", 3.5071),
        (5, "ofdm24", 16.2470),
        (20, "ofdm24", 14.0072),
        (5, "ofdm54", 29.8324),
        (20, "ofdm54", 26.2925),
    ],
)
def test_throughput_matches_bianchi(stations, mode, bianchi_mbps):
    seconds = {"ofdm6": 6, "ofdm24": 3, "ofdm54": 2}[mode]
    assert throughput_mbps(stations, mode, seconds=seconds) == pytest.approx(bianchi_mbps, rel=0.025)


@pytest.mark.parametrize(
    ("stations", "mode", "rts", "ns3_mbps"),
    [
        (2, "ofdm6", False, 4.7704),
        (5, "ofdm6", True, 4.6744),
        (20, "ofdm6", False, 3.7512),
        (50, "ofdm6", False, 3.3216),
        (5, "ofdm54", False, 24.5664),
        (5, "ofdm54", True, 18.5704),
    ],
)
def test_throughput_matches_ns3(stations, mode, rts, ns3_mbps):
    measured = throughput_mbps(
        stations,
        mode,
        seconds=6 if mode == "ofdm6" else 1.5,
        payload_bytes=1000,
        frame_bytes=1000 + UDP_BYTES + OVERHEAD_BYTES,
        rts=rts,
        control_mode="ofdm6",
        retry_limit=6,
        lifetime_ns=500_000_000,
    )
    assert measured == pytest.approx(ns3_mbps, rel=0.025)


def test_rts_reduces_the_cost_of_collisions():
    assert throughput_mbps(10, "ofdm6", seconds=2, rts=True) > 1.05 * throughput_mbps(10, "ofdm6", seconds=2)

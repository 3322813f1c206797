"""Saturated stations against Bianchi's model, corrected for finite windows; the values are ns-3's."""

import pytest
from netsim_air import Air

from netsim.frames import FrameKind
from netsim.mac.jobs import Job, Outcome
from netsim.phy.modes import phy_mode

PAYLOAD_BYTES = 1500
FRAME_BYTES = PAYLOAD_BYTES + 8 + 28
"""With LLC/SNAP, MAC header and FCS."""


def throughput_mbps(stations, mode, *, seconds, seed=1, rts=False):
    sink = stations
    air = Air(stations + 1, seed=seed)
    delivered = 0

    def feed(station):
        def done(_job, outcome):
            nonlocal delivered
            delivered += outcome is Outcome.ACKNOWLEDGED
            feed(station)

        job = Job(
            kind=FrameKind.DATA,
            destination=sink,
            mode=phy_mode(mode, 20),
            frame_bytes=FRAME_BYTES,
            expires_ns=2**61,
            retry_limit=7,
            done=done,
            rts=rts,
        )
        air.stations[station].enqueue("dcf", job)

    for station in range(stations):
        feed(station)
        feed(station)
    air.queue.run_until(round(seconds * 1e9))
    return delivered * PAYLOAD_BYTES * 8 / seconds / 1e6


def test_one_station_gets_what_the_timing_leaves():
    # DIFS 34 + 7.5 slots 67.5 + data 2072 + SIFS 16 + ACK 44 = 2233.5 us on average
    assert throughput_mbps(1, "ofdm6", seconds=2) == pytest.approx(12_000 / 2233.5, rel=0.005)


@pytest.mark.parametrize(
    ("stations", "mode", "bianchi_mbps"),
    [
        (5, "ofdm6", 4.7087),
        (10, "ofdm6", 4.3453),
        (20, "ofdm6", 3.9899),
        (5, "ofdm24", 16.2470),
        (10, "ofdm24", 15.1426),
        (20, "ofdm24", 14.0072),
    ],
)
def test_throughput_is_bianchis(stations, mode, bianchi_mbps):
    seconds = 4 if mode == "ofdm6" else 2
    assert throughput_mbps(stations, mode, seconds=seconds) == pytest.approx(bianchi_mbps, rel=0.03)


def test_rts_makes_collisions_cheap():
    assert throughput_mbps(10, "ofdm6", seconds=2, rts=True) > 1.05 * throughput_mbps(10, "ofdm6", seconds=2)

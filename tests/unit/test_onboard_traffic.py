"""What one station says on the radio."""

import numpy as np

from autopilot.config import Devices, OnboardConfig, Site
from autopilot.onboard import beacon as wire
from autopilot.onboard.own_state import OwnState
from autopilot.onboard.traffic import Traffic
from netsim.wire.messages import Broadcast, FtmResult

STATIONS = 200


def test_a_beacon_of_a_large_swarm_carries_the_newest_distances():
    traffic = Traffic(
        station=0,
        stations=STATIONS,
        config=OnboardConfig(),
        devices=Devices(),
        rng=np.random.default_rng(1),
    )
    for peer in range(1, STATIONS):
        result = FtmResult(
            peer=peer, seq=peer, status="ok", measured_ns=(1_000 + peer) * 1_000_000,
            ended_ns=(1_000 + peer) * 1_000_000, distance_m=10.0,
            distance_std_m=0.1, rssi_dbm=-60.0, round_trips=7, measurements=8,
        )  # fmt: skip
        assert traffic.measured(result) is not None
    own = OwnState(site=Site(), gps_delay_s=0.12)
    own.time_us = 1_200_000
    (broadcast,) = traffic.due(own, 1_200_000, 1_300_000, ranging=False)
    assert isinstance(broadcast, Broadcast)
    beacon = wire.decode(broadcast.payload)
    assert beacon is not None
    assert {item.peer for item in beacon.distances} == set(range(STATIONS - wire.MAX_RANGES, STATIONS))

"""The interface of the on-board application: a minimal one flies in place of the built-in one."""

import math

import numpy as np
from vehicle_world import Flight, vehicle_config

from autopilot.logs.vehicle_record import VEHICLE_RECORD, record
from autopilot.onboard.application import NOTHING, Estimate, OnboardOutput
from autopilot.vehicle import vehicle as vehicle_module
from netsim.wire.messages import Broadcast, Delivery

UNKNOWN = (math.nan, math.nan, math.nan)


class Echo:
    """Sends back each datagram that it receives."""

    phase = 7

    def __init__(self):
        self.seen, self.payloads = set(), []

    def on_mavlink(self, msg, _now_us):
        self.seen.add(msg.get_type())

    def on_request(self, _msg):
        return []

    def on_radio(self, items, _now_us):
        self.payloads += [item.payload for item in items]

    def on_timer(self, now_us):
        payloads, self.payloads = self.payloads, []
        items = [Broadcast(seq=i, at_us=now_us, payload=each) for i, each in enumerate(payloads)]
        return OnboardOutput((), tuple(items)) if items else NOTHING

    def estimate(self, _now_us):
        return Estimate(UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN)

    def troubles(self):
        return {"echoes_lost": 0}


def test_another_application_receives_telemetry_and_uses_the_radio(monkeypatch):
    monkeypatch.setattr(vehicle_module, "make_application", lambda _: Echo())
    flight = Flight(vehicle_config(onboard=True))
    for _ in range(500):
        flight.step()
    vehicle = flight.vehicle
    assert {"HEARTBEAT", "LOCAL_POSITION_NED"} <= vehicle.app.seen
    time_us = flight.now_us
    item = Delivery(source=1, seq=0, received_ns=1_000 * time_us, rssi_dbm=-60.0, payload=b"abc")
    vehicle.app.on_radio([item], time_us)
    sent = []
    for _ in range(10):  # the loop's period is 20 ms, 5 steps
        sent += flight.step().radio
    assert [each.payload for each in sent] == [b"abc"]
    assert vehicle.troubles() == {"offboard_rejected": 0, "echoes_lost": 0}
    assert np.frombuffer(record(vehicle), VEHICLE_RECORD)["phase"] == Echo.phase

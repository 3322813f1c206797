"""The core of a ground station: datagrams become frames, and frames datagrams, whatever they contain."""

import pytest

from autopilot.mavlink.radio_carrier import TELEMETRY_PORT
from harness.ground_station.relay import Relay
from netsim.wire.messages import DEFAULT_PORT, MAX_PAYLOAD_BYTES, Delivery, RxBatch, Sent


def relay_of(vehicles):
    return Relay(vehicles, queue_frames=64, queue_lifetime_us=500_000)


def batch(*items):
    return RxBatch(station=9, release_us=1, items=items)


def delivery(source, port=TELEMETRY_PORT):
    return Delivery(source=source, seq=1, received_ns=1, rssi_dbm=-60.0, payload=b"opaque", port=port)


def test_a_datagram_is_one_frame_to_its_vehicle():
    relay = relay_of(3)
    for vehicle in (2, 0, 2):
        relay.put(vehicle, b"not MAVLink")
    frames = relay.take()
    assert [(each.destination, each.payload, each.port, each.at_us) for each in frames] == [
        (vehicle, b"not MAVLink", TELEMETRY_PORT, 0) for vehicle in (2, 0, 2)
    ]
    assert len({each.seq for each in frames}) == 3
    assert relay.take() == []


def test_a_datagram_that_no_frame_holds_is_dropped_and_counted():
    relay = relay_of(1)
    relay.put(0, bytes(MAX_PAYLOAD_BYTES))
    relay.put(0, bytes(MAX_PAYLOAD_BYTES + 1))
    assert [len(each.payload) for each in relay.take()] == [MAX_PAYLOAD_BYTES]
    assert relay.dropped == {"datagrams_too_long": 1, "datagrams_overtaken": 0}
    assert relay.counts["uav 0"]["sent"] == 1


def test_deliveries_of_vehicles_at_the_port_of_telemetry_are_passed_on():
    relay = relay_of(2)
    items = [delivery(1), delivery(0, DEFAULT_PORT), delivery(2), delivery(0)]  # 2 is another station
    assert [*relay.datagrams(batch(*items))] == [(1, b"opaque"), (0, b"opaque")]
    assert [each["received"] for each in relay.counts.values()] == [1, 1]


def test_each_frame_is_counted_by_its_outcome():
    relay = relay_of(1)
    for _ in range(4):
        relay.put(0, b"")
    frames = relay.take()
    outcomes = zip(frames, ("acknowledged", "retry_limit", "expired"), strict=False)
    reports = [
        Sent(destination=0, seq=each.seq, ended_ns=1, status=status, attempts=1) for each, status in outcomes
    ]
    assert [*relay.datagrams(batch(*reports))] == []
    relay.on_refused(frames[3:])
    assert relay.counts["uav 0"] == {"sent": 4, "acknowledged": 1, "lost": 3, "received": 0}


@pytest.mark.parametrize("is_refused", [False, True])
def test_frames_with_an_outcome_make_room_for_those_that_wait(is_refused):
    relay = relay_of(1)
    for number in range(40):
        relay.put(0, bytes([number]))
    on_air = []
    while frames := relay.take():
        on_air += [each.payload[0] for each in frames]
        if is_refused:
            relay.on_refused(frames)
            continue
        reports = [Sent(destination=0, seq=each.seq, ended_ns=1, status="acknowledged", attempts=1)
                   for each in frames]  # fmt: skip
        assert [*relay.datagrams(batch(*reports))] == []
    assert on_air == [*range(40)]

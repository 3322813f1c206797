"""The core of a ground station: datagrams become frames, and frames datagrams, whatever they contain."""

from autopilot.mavlink.radio_carrier import TELEMETRY_PORT
from harness.ground_station.relay import Relay
from netsim.wire.messages import DEFAULT_PORT, MAX_PAYLOAD_BYTES, Delivery, Sent


def delivery(source, port=TELEMETRY_PORT):
    return Delivery(source=source, seq=1, received_ns=1, rssi_dbm=-60.0, payload=b"opaque", port=port)


def test_a_datagram_is_one_frame_to_its_vehicle():
    relay = Relay(3)
    frames = [relay.frame(vehicle, b"not MAVLink") for vehicle in (2, 0, 2)]
    assert [(each.destination, each.payload, each.port, each.at_us) for each in frames] == [
        (vehicle, b"not MAVLink", TELEMETRY_PORT, 0) for vehicle in (2, 0, 2)
    ]
    assert len({each.seq for each in frames}) == 3


def test_a_datagram_that_no_frame_holds_is_dropped_and_counted():
    relay = Relay(1)
    assert relay.frame(0, bytes(MAX_PAYLOAD_BYTES)) is not None
    assert relay.frame(0, bytes(MAX_PAYLOAD_BYTES + 1)) is None
    assert (relay.too_long, relay.counts["uav 0"]["sent"]) == (1, 1)


def test_deliveries_of_vehicles_at_the_port_of_telemetry_are_passed_on():
    relay = Relay(2)
    items = [delivery(1), delivery(0, DEFAULT_PORT), delivery(2), delivery(0)]  # 2 is another station
    assert [*relay.datagrams(items)] == [(1, b"opaque"), (0, b"opaque")]
    assert [each["received"] for each in relay.counts.values()] == [1, 1]


def test_each_frame_is_counted_by_its_outcome():
    relay = Relay(1)
    frames = [relay.frame(0, b"") for _ in range(4)]
    outcomes = zip(frames, ("acknowledged", "retry_limit", "expired"), strict=False)
    reports = [
        Sent(destination=0, seq=each.seq, ended_ns=1, status=status, attempts=1) for each, status in outcomes
    ]
    assert [*relay.datagrams(reports)] == []
    relay.on_refused(frames[3:])
    assert relay.counts["uav 0"] == {"sent": 4, "acknowledged": 1, "lost": 3, "received": 0}

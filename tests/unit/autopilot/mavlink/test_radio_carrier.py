"""The radio as carrier of a MAVLink link: what is the link's among the radio's items, and what it sends."""

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.input_budget import PARTNER_FRAMES_S, InputBudget
from autopilot.mavlink.links import MavlinkLink
from autopilot.mavlink.partners import BROADCAST
from autopilot.mavlink.radio_carrier import FIRST_SEQUENCE, TELEMETRY_PORT, FrameCounts, RadioCarrier
from netsim.wire.messages import DEFAULT_PORT, MAX_PAYLOAD_BYTES, Delivery, FtmResult, Sent, Survey

NORTH, SOUTH = 5, 6
STATIONS = {"north": NORTH, "south": SOUTH}
GROUND = Encoder(system=255, component=190)


def beat():
    return common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def delivery(source, payload=b"", port=TELEMETRY_PORT):
    return Delivery(source=source, seq=1, received_ns=1, rssi_dbm=-60.0, payload=payload, port=port)


def sent(seq, destination, status="acknowledged"):
    return Sent(destination=destination, seq=seq, ended_ns=1, status=status, attempts=1)


def radio_link(**options):
    carrier = RadioCarrier(STATIONS)
    return carrier, MavlinkLink(carrier, encoder=Encoder(system=1, component=1), **options)


def test_the_application_gets_all_items_but_those_of_the_link():
    carrier = RadioCarrier(STATIONS)
    ranged = FtmResult(
        peer=1, seq=3, status="ok", measured_ns=1, ended_ns=1, distance_m=1.0, distance_std_m=0.1,
        rssi_dbm=-60.0, round_trips=7, measurements=8,
    )  # fmt: skip
    survey = Survey(ended_ns=1, busy_ns=0)
    of_application = [delivery(NORTH, port=DEFAULT_PORT), sent(7, NORTH), ranged, survey]
    of_link = [delivery(NORTH, b"one"), sent(FIRST_SEQUENCE, NORTH), delivery(SOUTH, b"two")]
    items = [of_link[0], *of_application[:2], of_link[1], delivery(2), *of_application[2:], of_link[2]]
    carrier.counts["north"].sent = 1
    assert carrier.take_in(items) == of_application
    assert [carrier.receive(), carrier.receive(), carrier.receive()] == [
        (b"one", NORTH), (b"two", SOUTH), None,
    ]  # fmt: skip
    assert carrier.foreign == 1
    assert carrier.counts["north"] == FrameCounts(sent=1, acknowledged=1, received=1)


def test_every_message_goes_to_all_stations_and_a_reply_to_the_one_that_asked():
    carrier, link = radio_link()
    assert not link.active
    link.send([(BROADCAST, beat())])
    assert link.active
    items = carrier.take_out()
    assert [(item.destination, item.port) for item in items] == [
        (NORTH, TELEMETRY_PORT), (SOUTH, TELEMETRY_PORT),
    ]  # fmt: skip
    assert carrier.take_out() == ()
    carrier.take_in([delivery(SOUTH, GROUND.encode(beat()))])
    ((number, message),) = link.receive(0)
    assert message.get_srcSystem() == 255
    carrier.now_us = 44_000
    link.send([(number, beat())])
    (reply,) = carrier.take_out()
    assert (reply.destination, reply.at_us) == (SOUTH, 44_000)
    # to each station without a gap in the numbers of MAVLink
    assert [Parser().push_datagram(each.payload)[0].get_seq() for each in (items[1], reply)] == [0, 1]


def test_sequence_numbers_rise_and_are_beyond_those_of_applications():
    carrier, link = radio_link()
    for _ in range(3):
        link.send([(BROADCAST, beat())])
    numbers = [item.seq for item in carrier.take_out()]
    assert numbers == [FIRST_SEQUENCE + i for i in range(6)]


def test_a_lost_frame_leaves_the_station_a_partner():
    carrier, link = radio_link()
    for i, status in enumerate(("retry_limit", "expired", "overflow", "acknowledged")):
        link.send([(BROADCAST, beat())])
        carrier.take_in([sent(FIRST_SEQUENCE + 2 * i, NORTH, status)])
    assert carrier.counts["north"] == FrameCounts(sent=4, acknowledged=1, lost=3)
    assert link.active


def test_the_messages_of_a_step_fit_frames():
    carrier, link = radio_link()
    link.send([(BROADCAST, beat()) for _ in range(500)])
    sizes = [len(item.payload) for item in carrier.take_out() if item.destination == NORTH]
    assert sum(sizes) == 500 * 21
    assert max(sizes) <= MAX_PAYLOAD_BYTES
    assert len(sizes) == -(-500 // (1400 // 21))


def test_the_input_budget_follows_simulated_time_alone():
    carrier, link = radio_link(budget=InputBudget())
    read = []
    for step in range(1_000):  # 4 s, with 1000 datagrams a second
        carrier.take_in([delivery(NORTH, GROUND.encode(beat()))] * 4)
        read += link.receive(4_000 * step)
    assert abs(len(read) - 5 * PARTNER_FRAMES_S) < 10  # the first second's worth at once

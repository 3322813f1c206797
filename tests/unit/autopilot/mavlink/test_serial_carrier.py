"""MAVLink over a vehicle's serial modem: pieces of a stream, reports, and all other items."""

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.links import MavlinkLink
from autopilot.mavlink.partners import BROADCAST
from autopilot.mavlink.serial_carrier import SerialCarrier
from autopilot.mavlink.signing import KEY_BYTES, Signer
from netsim.wire.messages import SerialBytes, SerialReceived, SerialReport, Survey

GROUND = 3
BEAT = common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
REPORT = SerialReport(
    peer=GROUND, seq=9, received_ns=9, rssi=90, remrssi=91, txbuf=100, noise=40, remnoise=41, rxerrors=2,
    fixed=1,
)  # fmt: skip


def make_link(carrier, **settings):
    return MavlinkLink(carrier, encoder=Encoder(system=1, component=1), is_stream=True, **settings)


def received(*pieces):
    return [
        SerialReceived(peer=GROUND, seq=i, received_ns=i, payload=bytes(piece))
        for i, piece in enumerate(pieces)
    ]


def test_the_stream_is_parsed_over_the_pieces_and_after_lost_bytes():
    carrier = SerialCarrier("ground", GROUND)
    link = make_link(carrier)
    encoder = Encoder(system=255, component=190)
    frames = [encoder.encode(BEAT) for _ in range(6)]
    # one frame in two pieces, one that lost its middle, one without its begin
    pieces = [
        frames[0][:7],
        frames[0][7:] + frames[1],
        frames[2][:5] + frames[2][9:] + frames[3],
        frames[4][6:],
        frames[5],
    ]
    survey = Survey(ended_ns=9, busy_ns=0)
    assert carrier.take_in([*received(*pieces), REPORT, survey]) == [survey]
    messages = link.receive(0)
    assert [message.get_seq() for _, message in messages] == [0, 1, 3, 5]
    assert {number for number, _ in messages} == {0}
    assert link.counters.bytes_bad > 0
    assert carrier.take_reports() == [REPORT]
    assert carrier.take_reports() == []
    assert (carrier.counts["ground"].received_bytes, carrier.counts["ground"].radio_status) == (
        sum(map(len, pieces)), 1,
    )  # fmt: skip


def test_messages_are_written_to_the_modem_as_whole_frames():
    carrier = SerialCarrier("ground", GROUND)
    link = make_link(carrier)
    carrier.now_us = 8_000
    link.send([(BROADCAST, BEAT), (BROADCAST, BEAT)])
    (item,) = carrier.take_out()
    assert isinstance(item, SerialBytes)
    assert (item.at_us, item.peer, len(item.payload)) == (8_000, GROUND, 2 * 21)
    assert carrier.take_out() == ()
    assert carrier.counts["ground"].sent_bytes == 42


def test_signed_frames_are_required_from_the_other_end():
    carrier = SerialCarrier("ground", GROUND)
    link = make_link(carrier, signer=Signer(bytes(KEY_BYTES), link_id=0))
    carrier.take_in(received(Encoder(system=255, component=190).encode(BEAT)))
    assert link.receive(0) == []
    assert link.counters.unsigned == 1

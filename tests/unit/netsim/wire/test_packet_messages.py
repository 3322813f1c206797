"""Messages of packets: round trips, and invalid bytes decode to None."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netsim.wire.messages import VERSION
from netsim.wire.packets import (
    MAX_PACKET_BYTES,
    ReceivedPacket,
    ReceivedPackets,
    SentPacket,
    SentPackets,
    decode_received,
    decode_sent,
    encode_packets,
)

SENT = SentPackets(
    packets=(
        SentPacket(
            station=2, destination=b"\xff" * 6, ether_type=0x0806, category="vo", read_ns=2**63 - 1,
            payload=bytes(MAX_PACKET_BYTES),
        ),
    )
)  # fmt: skip
RECEIVED = ReceivedPackets(
    packets=(
        ReceivedPacket(
            stations=(0, 65_535), source=1, destination=bytes(6), ether_type=0x0600, due_ns=0, payload=b""
        ),
    ),
    ended=((1, 3),),
)


def test_messages_survive_a_round_trip():
    assert decode_sent(encode_packets(SENT)) == SENT
    assert decode_received(encode_packets(RECEIVED)) == RECEIVED


@given(st.binary(max_size=200))
def test_any_bytes_decode_to_a_message_or_none(data):
    for decode, kind in ((decode_sent, SentPackets), (decode_received, ReceivedPackets)):
        assert decode(data) is None or isinstance(decode(data), kind)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("station", 65_536),
        ("destination", bytes(5)),
        ("destination", bytes(7)),
        ("ether_type", 0x05FF),
        ("ether_type", 0x10000),
        ("category", "xx"),
        ("read_ns", -1),
        ("payload", bytes(MAX_PACKET_BYTES + 1)),
    ],
)
def test_a_field_out_of_range_decodes_to_none(field, value):
    (packet,) = SENT.packets
    invalid = SentPackets(packets=(msgspec.structs.replace(packet, **{field: value}),))
    assert decode_sent(encode_packets(invalid)) is None


def test_another_version_decodes_to_none():
    for message, decode in ((SENT, decode_sent), (RECEIVED, decode_received)):
        other = msgspec.structs.replace(message, version=VERSION + 1)
        assert decode(encode_packets(other)) is None

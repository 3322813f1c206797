"""Wire messages: what is sent is what arrives, and hostile bytes are None."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netsim.wire.messages import (
    VERSION,
    Ack,
    Advance,
    Advanced,
    Broadcast,
    Delivery,
    FtmRequest,
    FtmResult,
    RxBatch,
    TxBatch,
    decode,
    encode,
)

MESSAGES = [
    TxBatch(
        station=3,
        now_us=4000,
        items=(Broadcast(seq=1, at_us=4100, payload=b"\x00\xff"), FtmRequest(seq=2, at_us=4200, peer=5)),
    ),
    RxBatch(
        station=0,
        release_us=8000,
        items=(
            Delivery(source=1, seq=7, received_ns=4_123_456, rssi_dbm=-61.5, payload=b"abc"),
            FtmResult(
                peer=2,
                seq=9,
                status="ok",
                measured_ns=5_000_000,
                distance_m=8.5,
                distance_std_m=0.1,
                rssi_dbm=-60.0,
                round_trips=7,
            ),
        ),
    ),
    Ack(),
    Advance(
        to_us=4000,
        release_us=8000,
        pos_ned_m=((0.0, 1.0, -2.0),),
        vel_ned_m_s=((0.0, 0.0, 0.0),),
        q_ned_frd=((1.0, 0.0, 0.0, 0.0),),
    ),
    Advanced(to_us=4000, quiet_until_us=2**60, busy_ns=12, unresponsive=(3,)),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_round_trip(message):
    assert decode(type(message), encode(message)) == message


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_another_version_is_none(message):
    assert decode(type(message), encode(msgspec.structs.replace(message, version=VERSION + 1))) is None


@pytest.mark.parametrize("message", MESSAGES[:2] + MESSAGES[3:], ids=lambda message: type(message).__name__)
def test_every_cut_is_none(message):
    whole = encode(message)
    assert all(decode(type(message), whole[:n]) is None for n in range(len(whole)))


@given(st.binary(max_size=200), st.sampled_from([TxBatch, RxBatch, Ack, Advance, Advanced]))
def test_random_bytes_never_raise(data, kind):
    message = decode(kind, data)
    assert message is None or encode(message)


def test_out_of_range_fields_are_none():
    raw = msgspec.msgpack.encode([VERSION, 3, 4000, [["b", 1, 4100, b"x" * 2000]]])
    assert decode(TxBatch, raw) is None
    raw = msgspec.msgpack.encode([VERSION, -3, 4000, []])
    assert decode(TxBatch, raw) is None

"""Wire messages: round trips, and invalid bytes decode to None."""

import struct

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netsim.wire.lockstep import pack_rows, unpack_rows
from netsim.wire.messages import (
    DEFAULT_PORT,
    VERSION,
    Ack,
    Broadcast,
    Delivery,
    Directory,
    DirectoryRequest,
    FtmRequest,
    FtmResult,
    RxBatch,
    Sent,
    Survey,
    TxBatch,
    Unicast,
    decode,
    encode,
)

MESSAGES = [
    TxBatch(
        station=3,
        now_us=4000,
        items=(
            Broadcast(seq=1, at_us=4100, payload=b"\x00\xff"),
            FtmRequest(seq=2, at_us=4200, peer=5),
            Unicast(seq=3, at_us=4300, destination=1, payload=b"to one", port=1),
        ),
    ),
    RxBatch(
        station=0,
        release_us=8000,
        items=(
            Delivery(source=1, seq=7, received_ns=4_123_456, rssi_dbm=-61.5, payload=b"abc", port=65_535),
            FtmResult(
                peer=2,
                seq=9,
                status="ok",
                measured_ns=5_000_000,
                ended_ns=5_000_000,
                distance_m=8.5,
                distance_std_m=0.1,
                rssi_dbm=-60.0,
                round_trips=7,
                measurements=8,
            ),
            Sent(destination=2, seq=11, ended_ns=5_100_000, status="acknowledged", attempts=1),
            Survey(ended_ns=8_000_000, busy_ns=1_234_567),
        ),
    ),
    Ack(),
    DirectoryRequest(),
    Directory(run_id="ab12", vehicles=8, guests=("ground",)),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_round_trip(message):
    assert decode(type(message), encode(message)) == message


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_other_version_decodes_to_none(message):
    assert decode(type(message), encode(msgspec.structs.replace(message, version=VERSION + 1))) is None


@pytest.mark.parametrize(
    "message",
    [m for m in MESSAGES if not isinstance(m, Ack | DirectoryRequest)],
    ids=lambda message: type(message).__name__,
)
def test_truncated_messages_decode_to_none(message):
    whole = encode(message)
    assert all(decode(type(message), whole[:n]) is None for n in range(len(whole)))


@given(st.binary(max_size=200), st.sampled_from([type(message) for message in MESSAGES]))
def test_random_bytes_never_raise(data, kind):
    message = decode(kind, data)
    assert message is None or encode(message)


def test_batch_without_the_more_field_is_the_last():
    """Encoding of stations outside the lockstep, without the later field."""
    for kind in (TxBatch, RxBatch):
        batch = decode(kind, msgspec.msgpack.encode([VERSION, 3, 4000, []]))
        assert (batch.station, batch.items, batch.more) == (3, (), False)


def test_out_of_range_fields_decode_to_none():
    raw = msgspec.msgpack.encode([VERSION, 3, 4000, [["b", 1, 4100, b"x" * 2000]]])
    assert decode(TxBatch, raw) is None
    raw = msgspec.msgpack.encode([VERSION, -3, 4000, []])
    assert decode(TxBatch, raw) is None


def test_a_datagram_without_a_port_has_the_default():
    items = [["b", 1, 4100, b"abc"], ["u", 1, 4100, 2, b"abc"]]
    batch = decode(TxBatch, msgspec.msgpack.encode([VERSION, 3, 4000, items]))
    assert [item.port for item in batch.items] == [DEFAULT_PORT] * 2


@pytest.mark.parametrize("port", [0, -1, 65_536, "80", None])
def test_a_port_that_udp_does_not_have_decodes_to_none(port):
    raw = msgspec.msgpack.encode([VERSION, 3, 4000, [["b", 1, 4100, b"abc", port]]])
    assert decode(TxBatch, raw) is None


@pytest.mark.parametrize("item", [["b", 2**63, 4100, b""], ["b", 1, 2**53 + 1, b""], ["f", 2**63, 4100, 1]])
def test_numbers_that_exceed_the_logs_decode_to_none(item):
    assert decode(TxBatch, msgspec.msgpack.encode([VERSION, 3, 4000, [item]])) is None
    fits = [item[0], min(item[1], 2**63 - 1), min(item[2], 2**53), item[3]]
    assert decode(TxBatch, msgspec.msgpack.encode([VERSION, 3, 4000, [fits]])) is not None


def test_rows_are_little_endian_float64_in_row_order():
    matrix = np.array([[1.0, -2.0, 3.5], [4.0, 5.0, -0.0]])
    for each in (matrix, np.asfortranarray(matrix), matrix.astype(">f8")):
        assert pack_rows(each) == struct.pack("<6d", 1.0, -2.0, 3.5, 4.0, 5.0, -0.0)


@given(st.lists(st.tuples(*[st.floats()] * 4), min_size=1, max_size=5))
def test_rows_round_trip_to_the_last_bit(rows):
    packed = pack_rows(np.array(rows))
    assert unpack_rows(packed, stations=len(rows), columns=4).tobytes() == np.array(rows).tobytes()


@pytest.mark.parametrize("size", [0, 1, 8, 23, 47, 49, 72])
def test_rows_of_wrong_length_decode_to_none(size):
    assert unpack_rows(bytes(size), stations=2, columns=3) is None

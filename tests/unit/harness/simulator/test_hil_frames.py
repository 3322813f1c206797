"""Frames of all vehicles at once, compared with pymavlink's frames of the same fields. Under 1 s."""

import numpy as np
import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink.frame import checksum
from autopilot.mavlink.hil_schema import HIL_GPS, HIL_SENSOR, SCHEMAS
from harness.simulator import hil_frames
from harness.simulator.hil_frames import InertialFrames, encode_rows


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: str(schema.message_id))
def test_frames_equal_those_of_pymavlink_for_the_same_payload(schema):
    """For every length of the payload after trailing zeros are truncated."""
    message_id, size = schema.message_id, schema.payload_bytes
    rng = np.random.default_rng(message_id)
    payloads = rng.integers(1, 256, (size + 1, size), dtype=np.uint8)
    for length, payload in enumerate(payloads):
        payload[length:] = 0
    rows = np.frombuffer(payloads.tobytes(), dtype=schema.dtype)
    sender = common.MAVLink(None, srcSystem=0, srcComponent=1)
    extra = common.mavlink_map[message_id].crc_extra
    for sequence in (0, 7, 255):
        sender.seq = sequence
        message = common.MAVLink_message(message_id, "any")
        expected = [message._pack(sender, extra, payload.tobytes()) for payload in payloads]
        assert encode_rows(schema, rows, sequence) == expected
    assert [len(frame) for frame in expected] == [12 + max(length, 1) for length in range(size + 1)]


def test_the_checksum_is_crc16_mcrf4xx():
    """CRC-16/MCRF4XX of "123456789" is 0x6F91: https://reveng.sourceforge.io/crc-catalogue/16.htm."""
    octets = np.frombuffer(b"*123456789*", dtype=np.uint8)
    assert checksum(octets, 1, 9, ord("9")) == crc16.mcrf4xx(b"123456789") == 0x6F91


def test_the_interpreted_kernel_writes_the_same_frames():
    kernel = hil_frames.make_frames
    interpreted = getattr(kernel, "py_func", kernel)
    payloads = np.random.default_rng(1).integers(0, 256, (3, 65), dtype=np.uint8)
    payloads[1, 40:] = payloads[2] = 0
    made = []
    for function in (kernel, interpreted):
        frames, lengths = np.zeros((3, 77), dtype=np.uint8), np.zeros(3, dtype=np.int64)
        function(np.arange(10, dtype=np.uint8), 108, payloads, frames, lengths)
        made.append([frame[:length].tobytes() for frame, length in zip(frames, lengths, strict=True)])
    assert made[0] == made[1]
    assert [len(frame) for frame in made[0]] == [77, 52, 13]


def test_inertial_frames_equal_those_of_the_general_encoder():
    """`encode_rows` is checked against pymavlink above; samples are of every magnitude and 0."""
    rng = np.random.default_rng(3)
    inertial = InertialFrames(5, 0x3F)
    for step in range(300):
        accel, gyro = rng.normal(size=(2, 5, 3)) * 10.0 ** rng.integers(-30, 30, (2, 5, 3))
        accel[rng.random((5, 3)) < 0.1] = 0.0
        rows = np.zeros(5, HIL_SENSOR.dtype)
        rows["time_usec"], rows["fields_updated"] = step * 4_000_000_000, 0x3F
        rows["xacc"], rows["yacc"], rows["zacc"] = accel.T
        rows["xgyro"], rows["ygyro"], rows["zgyro"] = gyro.T
        expected = encode_rows(HIL_SENSOR, rows, step % 256)
        assert inertial.at(step * 4_000_000_000, accel, gyro, step % 256) == expected


def test_no_vehicles_have_no_frames():
    assert encode_rows(HIL_GPS, np.zeros(0, HIL_GPS.dtype), 0) == []

"""Frames of all vehicles at once, compared with pymavlink's frames of the same fields. Under 1 s."""

import numpy as np
import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect
from autopilot.mavlink.frame import checksum
from harness.simulator import hil_frames
from harness.simulator.hil_frames import FrameLayout, InertialFrames

KINDS = {
    common.MAVLINK_MSG_ID_HIL_SENSOR: hil_frames.HIL_SENSOR,
    common.MAVLINK_MSG_ID_HIL_GPS: hil_frames.HIL_GPS,
    common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: hil_frames.HIL_STATE_QUATERNION,
    common.MAVLINK_MSG_ID_RC_CHANNELS: hil_frames.RC_CHANNELS,
    dialect.ESC_STATUS: hil_frames.ESC_STATUS,
}


@pytest.mark.parametrize("message_id", KINDS)
def test_a_row_has_the_memory_layout_of_its_message_on_the_wire(message_id):
    unpacker = common.mavlink_map[message_id].unpacker
    kind = KINDS[message_id]
    assert kind.dtype.itemsize == unpacker.size
    letters = {"f": "f", "i": "iqhb", "u": "IQHB"}
    wire = [code for count, code in _counted(unpacker.format.lstrip("<")) for _ in range(count)]
    rows = [
        (base.kind, base.itemsize)
        for name in kind.dtype.names
        for base, shape in [kind.dtype[name].subdtype or (kind.dtype[name], ())]
        for _ in range(int(np.prod(shape)))
    ]
    assert len(rows) == len(wire)
    for (letter, size), code in zip(rows, wire, strict=True):
        assert code in letters[letter]
        assert np.dtype(code).itemsize == size


def _counted(codes):
    """Yield the letters of a `struct` format with their repeat counts."""
    number = ""
    for code in codes:
        if code.isdigit():
            number += code
        else:
            yield int(number or 1), code
            number = ""


@pytest.mark.parametrize("message_id", KINDS)
def test_frames_equal_those_of_pymavlink_for_the_same_payload(message_id):
    """For every length of the payload after trailing zeros are truncated."""
    kind, size = KINDS[message_id], KINDS[message_id].dtype.itemsize
    rng = np.random.default_rng(message_id)
    payloads = rng.integers(1, 256, (size + 1, size), dtype=np.uint8)
    for length, payload in enumerate(payloads):
        payload[length:] = 0
    rows = np.frombuffer(payloads.tobytes(), dtype=kind.dtype)
    sender = common.MAVLink(None, srcSystem=0, srcComponent=1)
    extra = common.mavlink_map[message_id].crc_extra
    for sequence in (0, 7, 255):
        sender.seq = sequence
        message = common.MAVLink_message(message_id, "any")
        expected = [message._pack(sender, extra, payload.tobytes()) for payload in payloads]
        assert kind.frames(rows, sequence) == expected
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
        function(np.arange(10, dtype=np.uint8), 200, 108, payloads, frames, lengths)
        made.append([frame[:length].tobytes() for frame, length in zip(frames, lengths, strict=True)])
    assert made[0] == made[1]
    assert [len(frame) for frame in made[0]] == [77, 52, 13]


def test_inertial_frames_equal_those_of_the_general_encoder():
    """`FrameLayout` is checked against pymavlink above; samples are of every magnitude and 0."""
    rng = np.random.default_rng(3)
    inertial = InertialFrames(5, 0x3F)
    for step in range(300):
        accel, gyro = rng.normal(size=(2, 5, 3)) * 10.0 ** rng.integers(-30, 30, (2, 5, 3))
        accel[rng.random((5, 3)) < 0.1] = 0.0
        rows = np.zeros(5, hil_frames.HIL_SENSOR.dtype)
        rows["time_usec"], rows["fields_updated"] = step * 4_000_000_000, 0x3F
        rows["acc"], rows["gyro"] = accel, gyro
        expected = hil_frames.HIL_SENSOR.frames(rows, step % 256)
        assert inertial.at(step * 4_000_000_000, accel, gyro, step % 256) == expected


def test_no_vehicles_have_no_frames():
    assert (
        FrameLayout(common.MAVLINK_MSG_ID_HIL_GPS, [("time_usec", "<u8")]).frames(np.zeros(0, "<u8"), 0) == []
    )

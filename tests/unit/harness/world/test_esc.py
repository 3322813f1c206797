"""ESC_STATUS on the wire: values, checksum, position before the sensors. Under 1 s."""

import struct

import numpy as np
import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink.hil import EscReport, HilParser, HilSensor
from autopilot.mavlink.hil_schema import ESC_STATUS
from foundation.airframe.files import IRIS, load
from harness.simulator.hil import SensorEncoder
from harness.simulator.hil_frames import encode_rows
from harness.world import esc
from harness.world.sensors.suite import GpsFixes, SensorFrame

SPEEDS = np.array([[806.7, 0.0, 1100.0, 403.35], [806.7] * 4])
ESCS = esc.SpeedControllers([IRIS, IRIS])


def payload_of(frame):
    """Return the fields of a MAVLink 2 frame after checking header and checksum."""
    magic, length, incompatible, _, sequence, system, component, low, high = struct.unpack_from(
        "<BBBBBBBHB", frame
    )
    assert (magic, incompatible, low + (high << 16)) == (0xFD, 0, 291)
    assert len(frame) == 10 + length + 2
    (checksum,) = struct.unpack("<H", frame[-2:])
    assert checksum == crc16.mcrf4xx(frame[1:-2] + bytes([10]))
    payload = frame[10:-2].ljust(57, b"\0")
    return sequence, (system, component), struct.unpack("<Q4i4f4fB", payload)


def test_current_is_four_amperes_at_hover_and_proportional_to_the_cube_of_the_speed():
    """1100/806.7 cubed is 2.535; half the speed is an eighth; half a propeller takes half."""
    effectiveness = np.ones((2, 4))
    effectiveness[1, 0] = 0.5
    ((rows, _),) = ESCS.statuses(0, SPEEDS, effectiveness)
    np.testing.assert_allclose(rows["current"][0], (4.0, 0.0, 4.0 * 2.535, 0.5), rtol=1e-3)
    np.testing.assert_allclose(rows["current"][1], (2.0, 4.0, 4.0, 4.0))
    np.testing.assert_allclose(rows["rpm"][0], SPEEDS[0] * 9.5493, atol=0.51)


def test_current_is_proportional_to_the_density():
    """0.9 of the density at one vehicle, with whole and half propellers."""
    effectiveness = np.ones((2, 4))
    effectiveness[1, 0] = 0.5
    ((thick, _),) = ESCS.statuses(0, SPEEDS, effectiveness)
    ((thin, _),) = ESCS.statuses(0, SPEEDS, effectiveness, np.array((1.0, 0.9)))
    np.testing.assert_allclose(thin["current"], thick["current"] * [[1.0], [0.9]], rtol=1e-6)
    np.testing.assert_array_equal(thin["rpm"], thick["rpm"])


def frame_of(time_us, *, fix):
    gps = GpsFixes(
        lat_deg=np.zeros(2), lon_deg=np.zeros(2), alt_m=np.zeros(2), vel_ned_m_s=np.zeros((2, 3)),
        eph_m=1.0, epv_m=1.0,
    )  # fmt: skip
    return SensorFrame(
        time_us=time_us,
        accel_frd_m_s2=np.zeros((2, 3)),
        gyro_frd_rad_s=np.zeros((2, 3)),
        mag_frd_gauss=None,
        baro=None,
        gps=gps if fix else None,
    )


@pytest.mark.parametrize("fix", [False, True])
def test_it_is_sent_first_with_consecutive_sequence_numbers(fix):
    encoder = SensorEncoder()
    plain = [list(map(bytes, encoder.encode(4_000, frame_of(4_000, fix=False))))]  # overwritten later
    sent = encoder.encode(8_000, frame_of(8_000, fix=fix), ESCS.statuses(8_000, SPEEDS))
    assert plain[0][0][4] == 0
    for vehicle, data in enumerate(sent):
        length = 10 + data[1] + 2
        sequence, source, fields = payload_of(data[:length])
        assert (sequence, source) == (1, (0, 1))
        assert fields[0] == 8_000
        assert fields[1:5] == tuple(np.rint(SPEEDS[vehicle] * 9.549297).astype(int))
        assert fields[5:9] == (0.0,) * 4
        np.testing.assert_allclose(fields[9:13], 4.0 * (SPEEDS[vehicle] / 806.7) ** 3, rtol=1e-6)
        assert fields[13] == 0
        rest = HilParser(HilSensor).push(bytes(data[length:]))
        assert [m.get_msgId() for m in rest] == [common.MAVLINK_MSG_ID_HIL_GPS] * fix + [
            common.MAVLINK_MSG_ID_HIL_SENSOR
        ]
        assert data[length + 4] == 2
    assert encoder.encode(12_000, frame_of(12_000, fix=False))[0][4] == 3 + fix


def test_a_stopped_motor_shortens_the_frame_but_not_its_content():
    ((rows, _),) = esc.SpeedControllers([IRIS]).statuses(1, np.zeros((1, 4)))
    (frame,) = encode_rows(ESC_STATUS, rows, 255)
    assert frame[1] == 1  # the payload is only the low byte of the time
    assert payload_of(frame)[2] == (1, *[0] * 4, *[0.0] * 8, 0)


def test_six_motors_are_reported_in_two_messages_to_the_vehicles_that_have_them():
    """A quadrotor beside a hexacopter gets only the first one; 4 A at 806.7 rad/s is the Iris's alone."""
    hexacopter = load("hexacopter")
    speeds = np.full((2, 6), 540.0)
    first, second = esc.SpeedControllers([IRIS, hexacopter]).statuses(4_000, speeds)
    assert (first.absent, second.absent) == (frozenset(), frozenset({0}))
    assert (first.rows["index"].tolist(), second.rows["index"].tolist()) == ([0, 0], [4, 4])
    expected_a = hexacopter.motor_current_a * (540.0 / hexacopter.hover_rad_s) ** 3
    np.testing.assert_allclose(second.rows["current"][1], [expected_a] * 2 + [0.0] * 2, rtol=1e-6)
    quadrotor, six = (
        HilParser(EscReport).push(bytes(data))
        for data in SensorEncoder().encode(4_000, frame_of(4_000, fix=False), (first, second))
    )
    assert [message.index for message in quadrotor if isinstance(message, EscReport)] == [0]
    assert [message.index for message in six if isinstance(message, EscReport)] == [0, 4]

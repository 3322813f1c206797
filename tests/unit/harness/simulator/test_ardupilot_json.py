"""ArduPilot's JSON interface: servo packets, states as ArduPilot reads them, its clock, and GPS_INPUT."""

import math
import struct

import numpy as np
import pytest
from ardupilot_scanner import Receiver, scan
from pymavlink.dialects.v20 import ardupilotmega
from world_truth import truth_with

from autopilot.mavlink.codec import Encoder
from autopilot.parameters.config import Site
from harness.simulator.ardupilot_json import StateEncoder, servo_packet
from harness.world.active_faults import Faults
from harness.world.faults import BaroBias, BaroFreeze
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import BaroSamples, GpsFixes, SensorFrame, SensorSuite

SITE = Site()
STEP_US = 4_000
EPOCH_US = 1_767_225_600_000_000
ARMED = 128
GPS_EPOCH_S = 315_964_800  # 6 January 1980
LEAP_S = 18  # between GPS time and UTC since 2017
WEEK_S = 7 * 86_400


def packet(*pulses_us, channels=16, magic=None, count=7):
    magic = magic or {16: 18_458, 32: 29_569}[channels]
    return struct.pack(
        f"<HHI{channels}H", magic, 1_200, count, *pulses_us, *[0] * (channels - len(pulses_us))
    )


def truth_of(vehicles=2, **fields):
    """Return the truth of vehicles at rest on the ground, except for the given fields."""
    still = np.zeros((vehicles, 3))
    defaults = {
        "pos_ned_m": still, "vel_ned_m_s": still, "omega_frd_rad_s": still, "mean_omega_frd_rad_s": still,
        "acc_ned_m_s2": still, "rotor_speed_rad_s": np.zeros((vehicles, 4)),
        "q_ned_frd": np.tile([1.0, 0.0, 0.0, 0.0], (vehicles, 1)),
        "specific_force_frd_m_s2": np.tile([0.0, 0.0, -9.80665], (vehicles, 1)),
    }  # fmt: skip
    return truth_with(**(defaults | fields))


def frame_of(vehicles=2, time_us=STEP_US, **fields):
    defaults = {
        "accel_frd_m_s2": np.tile([0.0, 0.0, -9.80665], (vehicles, 1)),
        "gyro_frd_rad_s": np.zeros((vehicles, 3)),
        "mag_frd_gauss": None, "baro": None, "gps": None,
    }  # fmt: skip
    return SensorFrame(time_us=time_us, **(defaults | fields))


def encoder_of(vehicle=1, step_us=STEP_US, epoch_us=EPOCH_US, site=SITE):
    return StateEncoder(vehicle, site=site, step_us=step_us, epoch_us=epoch_us)


def encoded(encoder, time_us=STEP_US, frame=None, truth=None, controls=(0.0,) * 4, **armed):
    """Return the values of the line as ArduPilot reads them, and the bytes after the line."""
    given = (frame or frame_of(time_us=time_us), truth or truth_of(), np.array(controls))
    data = encoder.encode(time_us, *given, **({"armed": False} | armed))
    end = data.index(b"\n", 1) + 1
    assert data[:1] == b"\n"
    return scan(data[1 : end - 1].decode("ascii")), data[end:]


# ---- servo packets


@pytest.mark.parametrize("channels", [16, 32])
def test_a_servo_packet_holds_rate_number_and_pulses(channels):
    pulses_us = tuple(range(1_000, 1_000 + channels))
    assert servo_packet(packet(*pulses_us, channels=channels, count=2**32 - 1)) == (
        1_200,
        2**32 - 1,
        pulses_us,
    )
    assert servo_packet(memoryview(packet(*pulses_us, channels=channels))) is not None


@pytest.mark.parametrize(
    "data",
    [
        b"", b"\x1a", packet()[:2], packet()[:-1], packet() + b"\0", packet(magic=18_459),
        packet(magic=29_569),
        packet(channels=32, magic=18_458), packet(channels=32)[:-1], packet()[::-1],
    ],
)  # fmt: skip
def test_data_of_another_size_or_magic_number_is_no_packet(data):
    assert servo_packet(data) is None


def test_pulses_from_1_to_2_ms_are_controls_from_0_to_1_in_order():
    answer = servo_packet(packet(1_000, 1_250, 1_500, 2_000, 1_900)).answer(8_000)
    assert answer.time_usec == 8_000
    assert answer.controls == (0.0, 0.25, 0.5, 1.0, *[0.0] * 12)
    assert answer.flags == 0


def test_pulses_beyond_the_range_are_limited():
    answer = servo_packet(packet(0, 999, 2_001, 65_535)).answer(0)
    assert answer.controls[:4] == (0.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("pulses_us", "armed"),
    [
        ((0, 0, 0, 0), False),  # no output yet
        ((1_000, 1_000, 1_000, 1_000), False),
        ((1_100, 1_100, 1_100, 1_100), True),  # MOT_SPIN_ARM
        ((1_000, 1_000, 1_001, 1_000), True),
        ((1_000, 1_000, 1_000, 1_000, 2_000, 1_500), False),  # outputs that are no motors
    ],
)
def test_a_vehicle_is_armed_while_a_motor_has_a_pulse_above_the_least(pulses_us, armed):
    assert servo_packet(packet(*pulses_us)).answer(0).mode == (ARMED if armed else 0)


# ---- states


def test_every_field_has_its_unit_and_frame():
    half = math.sqrt(0.5)
    truth = truth_of(
        pos_ned_m=np.array([[9.0, 9.0, 9.0], [1.5, -2.25, -30.0]]),
        vel_ned_m_s=np.array([[9.0, 9.0, 9.0], [0.125, -4.5, 0.0625]]),
        q_ned_frd=np.array([[1.0, 0.0, 0.0, 0.0], [half, 0.0, 0.0, -half]]),
    )
    frame = frame_of(
        accel_frd_m_s2=np.array([[9.0] * 3, [0.5, -0.25, -9.5]]),
        gyro_frd_rad_s=np.array([[9.0] * 3, [-0.125, 1e-5, 2.5]]),
    )
    values, rest = encoded(encoder_of(), frame=frame, truth=truth)
    assert rest == b""
    assert values.keys() == {
        "timestamp", "gyro", "accel_body", "position", "velocity", "quaternion", "voltage", "current",
    }  # fmt: skip
    assert values["gyro"] == (-0.125, 1e-5, 2.5)
    assert values["accel_body"] == (0.5, -0.25, -9.5)
    assert values["position"] == (1.5, -2.25, 0.0)  # no sample of the barometer yet
    assert values["velocity"] == (0.125, -4.5, 0.0625)
    assert values["quaternion"] == pytest.approx((half, 0.0, 0.0, -half), abs=1e-7)
    # a full pack of three cells, 4.1 V each, with the avionics' current
    assert values["voltage"][0] == pytest.approx(3 * 4.1, abs=0.1)
    assert values["current"][0] == pytest.approx(1.0, abs=0.01)


def test_values_of_any_size_are_read_with_a_relative_error_of_a_millionth():
    generator = np.random.default_rng(3)
    for _ in range(300):
        vectors = generator.normal(size=(4, 2, 3)) * 10.0 ** generator.uniform(-6, 3, (4, 1, 1))
        truth = truth_of(pos_ned_m=vectors[0], vel_ned_m_s=vectors[1])
        frame = frame_of(accel_frd_m_s2=vectors[2], gyro_frd_rad_s=vectors[3])
        values, _ = encoded(encoder_of(), frame=frame, truth=truth)
        assert values["accel_body"] == pytest.approx(vectors[2, 1], rel=1e-6)
        assert values["gyro"] == pytest.approx(vectors[3, 1], rel=1e-6)
        assert values["position"][:2] == pytest.approx(vectors[0, 1, :2], abs=6e-5)
        assert values["velocity"] == pytest.approx(vectors[1, 1], abs=6e-6)
        assert all(map(math.isfinite, [number for value in values.values() for number in value]))


@pytest.mark.parametrize("step_us", [1_000, 2_000, 4_000, 5_000, 20_000])
def test_the_clock_of_truncated_differences_is_the_simulated_time(step_us):
    """Over 10^6 steps; the numbers are those of the lines, of which some are read."""
    encoder, receiver = encoder_of(step_us=step_us), Receiver()
    for step in range(1, 1_000_001):
        time_us = step * step_us
        if step < 100 or step % 50_000 < 2:
            timestamp_s = encoded(encoder, time_us)[0]["timestamp"][0]
            assert timestamp_s == pytest.approx(time_us * 1e-6 + step * 0.5e-6, abs=1e-9)
        else:
            timestamp_s = float(f"{(time_us + step * 0.5) * 1e-6:.7f}")
        receiver.advance(timestamp_s)
        if receiver.time_us != time_us:
            raise AssertionError(step)


def test_lines_in_sequence_are_each_read_and_advance_the_clock():
    encoder, receiver = encoder_of(), Receiver()
    for time_us in range(STEP_US, 100 * STEP_US, STEP_US):
        data = encoder.encode(time_us, frame_of(time_us=time_us), truth_of(), np.zeros(4), armed=False)
        assert receiver.receive(data)
        assert receiver.time_us == time_us
    assert receiver.accepted == 99
    # repeated: the state counts again, the clock stands still
    assert receiver.receive(data)
    assert receiver.time_us == time_us


# ---- barometer


def flown_height_m(suite, encoder, faults, height_m, steps, first):
    truth = truth_of(pos_ned_m=np.tile([0.0, 0.0, -height_m], (2, 1)))
    for step in range(first, first + steps):
        faults.advance(step * STEP_US)
        frame = suite.sample(step * STEP_US, truth, faults)
        values, _ = encoded(encoder, step * STEP_US, frame, truth)
    return -values["position"][2]


def test_the_height_is_the_barometers_with_its_faults():
    suite = SensorSuite(
        config=SensorsConfig(profile="ideal"), site=SITE, vehicles=2, step_us=STEP_US,
        seed=np.random.SeedSequence(1),
    )  # fmt: skip
    faults = Faults(
        (BaroBias(uav=1, start_s=1.0, duration_s=1.0, offset_m=3.0), BaroFreeze(uav=1, start_s=3.0)),
        (4, 4),
        np.random.default_rng(1),
    )
    encoder = encoder_of()
    assert flown_height_m(suite, encoder, faults, 20.0, 200, 1) == pytest.approx(20.0, abs=0.02)
    assert flown_height_m(suite, encoder, faults, 20.0, 100, 260) == pytest.approx(23.0, abs=0.02)
    assert flown_height_m(suite, encoder, faults, 20.0, 100, 600) == pytest.approx(20.0, abs=0.02)
    assert flown_height_m(suite, encoder, faults, 25.0, 100, 800) == pytest.approx(20.0, abs=0.02)


def test_the_height_stays_between_samples_of_the_barometer():
    encoder = encoder_of()
    samples = BaroSamples(np.array([950.0, 940.0]), np.array([15.0, 15.0]))
    expected_m = (1.0 - (940.0 / 1013.25) ** (1.0 / 5.255877)) * 288.15 / 6.5e-3 - SITE.altitude_m
    for time_us, baro in ((STEP_US, samples), (2 * STEP_US, None)):
        values, _ = encoded(encoder, time_us, frame_of(time_us=time_us, baro=baro))
        assert -values["position"][2] == pytest.approx(expected_m, abs=0.01)


# ---- battery


def test_the_battery_is_emptied_by_the_motors_while_armed():
    encoders = [encoder_of(), encoder_of()]
    volts = []
    for time_us in range(STEP_US, 60_000_000, 20_000):
        volts = [
            encoded(encoder, time_us, controls=(0.7,) * 4, armed=armed)[0]
            for encoder, armed in zip(encoders, (True, False), strict=True)
        ]
    flown, standing = volts
    # four motors of 4 A in hover, whose speed is 806.7 rad/s, at 800 rad/s, and the avionics
    assert flown["current"][0] == pytest.approx(1.0 + 16.0 * (0.8 / 0.8067) ** 3, rel=0.01)
    assert standing["current"][0] == pytest.approx(1.0, rel=0.01)
    assert flown["voltage"][0] < standing["voltage"][0] - 0.1


# ---- receiver


def fixes_of(lost=None):
    return GpsFixes(
        lat_deg=np.array([1.0, 47.123456789]), lon_deg=np.array([2.0, -8.987654321]),
        alt_m=np.array([3.0, 512.5]), vel_ned_m_s=np.array([[0.0] * 3, [1.5, -2.25, 0.5]]), eph_m=0.75,
        epv_m=1.25, lost=None if lost is None else np.array(lost),
    )  # fmt: skip


def gps_input(time_us, *, lost=None, epoch_us=EPOCH_US):
    """Return GPS_INPUT as pymavlink's own parser reads it."""
    encoder = encoder_of(epoch_us=epoch_us)
    _, rest = encoded(encoder, time_us, frame_of(time_us=time_us, gps=fixes_of(lost)))
    (message,) = ardupilotmega.MAVLink(None).parse_buffer(rest)
    assert message.get_type() == "GPS_INPUT"
    return message


def test_a_fix_is_sent_with_its_units_and_the_accuracies_of_the_model():
    message = gps_input(1_000_000)
    assert (message.lat, message.lon) == (471_234_568, -89_876_543)
    assert message.alt == 512.5
    assert (message.vn, message.ve, message.vd) == (1.5, -2.25, 0.5)
    assert (message.horiz_accuracy, message.vert_accuracy) == (0.75, 1.25)
    assert (message.fix_type, message.satellites_visible, message.gps_id) == (3, 10, 0)
    # the speed's accuracy alone is not given; heights and velocities are used
    assert message.ignore_flags == ardupilotmega.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY
    assert message.yaw == 0  # none
    assert message.time_usec == EPOCH_US + 1_000_000


def test_a_lost_fix_has_no_satellites_and_others_keep_theirs():
    message = gps_input(1_000_000, lost=[False, True])
    assert (message.fix_type, message.satellites_visible) == (1, 0)
    assert gps_input(1_000_000, lost=[True, False]).fix_type == 3


@pytest.mark.parametrize("before_ms", [1, 0, -1, -3_600_000])
@pytest.mark.parametrize("week", [0, 1, 2_400])
def test_the_week_and_the_time_in_it_are_those_of_gps_time(week, before_ms):
    begin_us = (GPS_EPOCH_S + week * WEEK_S - LEAP_S) * 1_000_000
    time_us = begin_us - before_ms * 1_000
    if time_us < (GPS_EPOCH_S - LEAP_S) * 1_000_000:
        expected = (0, 0)
    else:
        expected = (week - 1, WEEK_S * 1_000 - 1) if before_ms == 1 else (week, -before_ms)
    message = gps_input(1_000_000, epoch_us=time_us - 1_000_000)
    assert (message.time_week, message.time_week_ms) == expected


def test_no_date_is_the_first_week():
    message = gps_input(4_000, epoch_us=0)
    assert (message.time_week, message.time_week_ms) == (0, 0)


# ---- parameters


def test_requests_of_parameters_follow_the_line():
    encoder = StateEncoder(1, site=SITE, step_us=STEP_US, epoch_us=0, parameters=["WP_SPD"])
    assert encoded(encoder)[1] == b""
    beat = ardupilotmega.MAVLink_heartbeat_message(2, 3, 1, 0, 3, 3)
    Encoder(system=2, component=1).encode(beat)
    encoder.parameters.on_message(beat, 0)
    _, rest = encoded(encoder, 2 * STEP_US, frame_of(time_us=2 * STEP_US, gps=fixes_of()))
    request, fix = ardupilotmega.MAVLink(None).parse_buffer(rest)
    assert (request.get_type(), fix.get_type()) == ("PARAM_REQUEST_READ", "GPS_INPUT")
    assert (request.param_id, request.target_system, request.target_component) == ("WP_SPD", 2, 1)

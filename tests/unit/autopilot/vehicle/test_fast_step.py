"""The compiled fast step: the same flight as with full steps, to the bit."""

import pytest
from fastcrc import crc16
from host_players import Player
from pymavlink.dialects.v20 import common

from autopilot.mavlink.hil import TO_VEHICLE, HilParser, HilSensor, pack
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.services.service import GROUND_STATION, NEVER_US, Addressed, Partner
from autopilot.vehicle.shared_state import FastStepLimits
from autopilot.vehicle.vehicle import DECISION_PERIOD_US
from studies.vehicle.bench import record_flight
from studies.vehicle.estimation import MEASUREMENTS

FLIGHT_S = 24.0
STEP_US = 4_000
CONFIG = VehicleConfig(
    run_id="bench", instance=0, seed=7, onboard=OnboardConfig(localisation="gps"),
    places_ned_m=((0.0, 0.0, -5.0),),
)  # fmt: skip
CRC_EXTRA = bytes([common.mavlink_map[common.MAVLINK_MSG_ID_HIL_SENSOR].crc_extra])


@pytest.fixture(scope="module")
def stream():
    """Return the bytes of each step of a flight to a position and some seconds there."""
    return record_flight(FLIGHT_S).stream


def memory(host):
    """Return all memory that a fast step may write."""
    estimator, controller = host.vehicle.estimator, host.vehicle.pilot.controller
    shared = host.vehicle.shared
    blocks = (estimator.filter.block, estimator.filter.samples, controller.block, shared.block)
    return b"".join(block.tobytes() for block in blocks) + bytes(host._inertial._answer)


def until_inertial(player, stream):
    """Play until two fast steps have followed each other; return the bytes of the third."""
    in_a_row = 0
    for data in stream:
        if in_a_row == 2:
            return data
        before = player.inertial
        player.play(data)
        in_a_row = in_a_row + 1 if player.inertial > before else 0
    raise AssertionError("no inertial steps")


def _time_us(data):
    return int.from_bytes(data[10:18], "little")


def test_fast_steps_give_the_same_flight_to_the_bit(stream):
    compiled, plain = Player(CONFIG), Player(CONFIG, compiled=False)
    for data in stream:
        assert compiled.play(data) == plain.play(data)
    assert plain.inertial == 0
    assert compiled.inertial > 0.25 * len(stream)
    for of in (
        lambda host: host.vehicle.estimator.state,
        lambda host: host.vehicle.estimator.filter.block.tobytes(),
        lambda host: [getattr(host.vehicle.estimator.fusion, name) for name in MEASUREMENTS],
        lambda host: host.vehicle.flight.motors(),
        lambda host: host.vehicle.shared.block["clock"],
        lambda host: host.vehicle.pilot.controls,
        lambda host: host.vehicle.pilot.controller.block.tobytes(),
        lambda host: host.vehicle.shared.sequence,
    ):
        assert repr(of(compiled.host)) == repr(of(plain.host))


def test_in_flight_there_are_25_full_steps_a_second(stream):
    """GPS, compass, barometer, decisions, application, fusion: all due in the same steps."""
    player, whole_us = Player(CONFIG), []
    for data in stream:
        before = player.inertial
        player.play(data)
        if player.inertial == before:
            whole_us.append(player.host.vehicle.flight.now_us)
    begin_us = len(stream) * STEP_US - 3_000_000
    late_us = [time_us for time_us in whole_us if time_us > begin_us]
    assert late_us == list(range(late_us[0], len(stream) * STEP_US + 1, DECISION_PERIOD_US))
    assert len(late_us) == pytest.approx(75, abs=1)


def resealed(data, at, byte):
    """Return the frame with another byte at an offset, and the matching checksum."""
    changed = bytearray(data)
    changed[at] = byte
    changed[-2:] = crc16.mcrf4xx(bytes(changed[1:-2]) + CRC_EXTRA).to_bytes(2, "little")
    return bytes(changed)


def sensor_like(data, **fields):
    """Return a frame's HIL_SENSOR with some fields changed."""
    (message,) = HilParser(*TO_VEHICLE).push(data)
    return pack(message._replace(**fields), sequence=data[4], system=data[5], component=data[6])


OTHERS = {
    "not all of it": lambda data: data[:-1],
    "more than it": lambda data: data + b"\xfd",
    "a wrong checksum": lambda data: data[:-1] + bytes([data[-1] ^ 1]),
    "no frame": lambda data: resealed(data, 0, 0xFE),
    "a signed frame": lambda data: resealed(data, 2, 1),
    "another kind": lambda data: resealed(data, 7, common.MAVLINK_MSG_ID_HIL_GPS),
    "another kind, by its high byte": lambda data: resealed(data, 9, 1),
    "a delivery is announced": lambda data: sensor_like(data, fields_updated=0x3F | 1 << 30),
    "an airspeed": lambda data: sensor_like(data, fields_updated=0x3F | 0x400),
    "no acceleration": lambda data: sensor_like(data, fields_updated=0x38),
    "another sensor set": lambda data: sensor_like(data, id=1),
    "the same time again": lambda data: sensor_like(data, time_usec=_time_us(data) - STEP_US),
    "a time of long ago": lambda data: sensor_like(data, time_usec=1),
    "a time far ahead": lambda data: sensor_like(data, time_usec=_time_us(data) + 10_000_000),
    "a time beyond all": lambda data: sensor_like(data, time_usec=2**64 - 1),
    "no number": lambda data: sensor_like(data, xgyro=float("nan")),
    "what no sensor reads": lambda data: sensor_like(data, zacc=1e6),
}


@pytest.fixture(scope="module")
def flying(stream):
    player = Player(CONFIG)
    return player, until_inertial(player, stream)


@pytest.mark.parametrize("other", OTHERS)
def test_other_messages_are_not_fast_steps(flying, other):
    player, data = flying
    wrong = OTHERS[other](data)
    before = memory(player.host)
    assert player.host.inertial_step(player.host.put(wrong)) is None
    assert memory(player.host) == before
    assert bytes(player.host.incoming[: len(wrong)]) == wrong


def test_an_inertial_sample_is_a_fast_step(flying):
    """Verifies that the test above starts from a fast step."""
    player, data = flying
    before = memory(player.host)
    assert player.host.inertial_step(player.host.put(data)) is not None
    assert memory(player.host) != before


@pytest.mark.parametrize("limit", FastStepLimits._fields)
def test_each_limit_ends_the_fast_steps(stream, limit):
    """Horizon limits are compared with the time of the filter, which is late by the delay."""
    player = Player(CONFIG)
    host, data = player.host, until_inertial(player, stream)
    limited_us = _time_us(data)
    if limit == "horizon_us":
        limited_us -= int(host.vehicle.estimator.filter.block["delay_us"][0])
    sample = sensor_like(data, fields_updated=0x3F | 0x1C0)
    limits = host.vehicle.shared.block["limits"]
    for name in FastStepLimits._fields:
        limits[name] = NEVER_US
    limits[limit] = limited_us
    assert host.inertial_step(host.put(sample)) is None
    limits[limit] = limited_us + 1
    assert host.inertial_step(host.put(sample)) is not None


@pytest.mark.parametrize("fields", [0x1C0, 0x1A00, 0x1C0 | 0x1A00])
def test_compass_and_barometer_are_skipped_until_a_reading_is_due(stream, fields):
    player = Player(CONFIG)
    host, data = player.host, until_inertial(player, stream)
    reading = sensor_like(data, fields_updated=0x3F | fields, abs_pressure=1000.0)
    limits = host.vehicle.shared.block["limits"]
    limits["aiding_us"] = _time_us(data)
    assert host.inertial_step(host.put(reading)) is None
    limits["aiding_us"] = _time_us(data) + 1
    assert host.inertial_step(host.put(reading)) is not None


def test_while_the_simulator_is_silent_the_state_is_that_of_the_last_step(stream):
    player = Player(CONFIG)
    data = until_inertial(player, stream)
    player.play(data)
    host = player.host
    beat = common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    host.serve_while_paused([Addressed(Partner(GROUND_STATION, 0), beat)])
    flight = host.vehicle.flight
    assert flight.now_us == flight.clock.estimate_us == _time_us(data)
    assert flight.sensor == HilParser(*TO_VEHICLE).push(data)[0]
    assert isinstance(flight.sensor, HilSensor)


def test_with_an_active_link_every_step_is_full(stream):
    player = Player(CONFIG)
    data = until_inertial(player, stream)
    host = player.host
    for messages in host.push(host.put(data)):
        host.step(messages, link_messages=[], link_active=(True, False))
    assert host.inertial_step(host.put(sensor_like(data, time_usec=_time_us(data) + STEP_US))) is None

"""A step of an inertial sample alone, compiled: the same flight as by all of the vehicle, to the bit."""

import pytest
from fastcrc import crc16
from pymavlink.dialects.v20 import common

from autopilot.mavlink.hil import TO_VEHICLE, HilParser, HilSensor, pack
from autopilot.parameters.config import OnboardConfig, VehicleConfig
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.host import Host
from autopilot.vehicle.vehicle import DECISION_PERIOD_US
from studies.vehicle.bench import record_flight

FLIGHT_S = 24.0
STEP_US = 4_000
CONFIG = VehicleConfig(
    run_id="bench", instance=0, seed=7, onboard=OnboardConfig(localisation="gps"),
    places_ned_m=((0.0, 0.0, -5.0),),
)  # fmt: skip
NOBODY = (False, False)
CRC_EXTRA = bytes([common.mavlink_map[common.MAVLINK_MSG_ID_HIL_SENSOR].crc_extra])


@pytest.fixture(scope="module")
def stream():
    """Bytes of each step of a flight to its place and some seconds there."""
    return record_flight(FLIGHT_S).stream


class Player:
    """A host and what it answers; ``compiled``: steps may be made by compiled code."""

    def __init__(self, *, compiled: bool) -> None:
        self.host = Host(CONFIG, None)
        self.inertial = 0
        if not compiled:
            self.host._inertial.open = lambda *_, **__: None

    def hear(self, data):
        host = self.host
        size = host.put(data)
        answer = host.inertial_step(size)
        if answer is not None:
            self.inertial += 1
            return bytes(answer)
        return b"".join(
            host.step(messages, link_messages=[], link_active=NOBODY)[0] for messages in host.push(size)
        )


def memory(host):
    """All that an inertial step may write."""
    estimator, controller = host.vehicle.estimator, host.vehicle.pilot.controller
    steps = host._inertial
    blocks = (estimator.filter.block, estimator.filter.samples, controller.block, steps._moment)
    return b"".join(block.tobytes() for block in blocks) + bytes(steps._answer)


def until_inertial(player, stream):
    """Play up to where two inertial steps have followed each other; gives the bytes of the third."""
    in_a_row = 0
    for data in stream:
        if in_a_row == 2:
            return data
        before = player.inertial
        player.hear(data)
        in_a_row = in_a_row + 1 if player.inertial > before else 0
    raise AssertionError("no inertial steps")


def _time_us(data):
    return int.from_bytes(data[10:18], "little")


def test_the_flight_is_the_same_to_the_bit(stream):
    compiled, plain = Player(compiled=True), Player(compiled=False)
    for data in stream:
        assert compiled.hear(data) == plain.hear(data)
    assert plain.inertial == 0
    assert compiled.inertial > 0.25 * len(stream)
    compiled.host._catch_up()
    for of in (
        lambda host: host.vehicle.estimator.state,
        lambda host: host.vehicle.estimator.diagnostics,
        lambda host: list(host.vehicle.flight.motors),
        lambda host: host.vehicle.flight.now_us,
        lambda host: host.vehicle.pilot.controls,
        lambda host: host.vehicle.pilot.controller.block.tobytes(),
        lambda host: host._encoder.sequence,
    ):
        assert repr(of(compiled.host)) == repr(of(plain.host))


def test_on_its_way_a_vehicle_looks_at_more_than_the_sample_25_times_a_second(stream):
    """GPS, compass, barometer, decisions, application, what is due of the filter: all in the same steps."""
    player, whole_us = Player(compiled=True), []
    for data in stream:
        before = player.inertial
        player.hear(data)
        if player.inertial == before:
            whole_us.append(player.host.vehicle.flight.now_us)
    begin_us = len(stream) * STEP_US - 3_000_000
    late_us = [time_us for time_us in whole_us if time_us > begin_us]
    assert late_us == list(range(late_us[0], len(stream) * STEP_US + 1, DECISION_PERIOD_US))
    assert len(late_us) == pytest.approx(75, abs=1)


def resealed(data, at, byte):
    """The frame with another byte at a place, and the checksum that belongs to it."""
    changed = bytearray(data)
    changed[at] = byte
    changed[-2:] = crc16.mcrf4xx(bytes(changed[1:-2]) + CRC_EXTRA).to_bytes(2, "little")
    return bytes(changed)


def sensor_like(data, **fields):
    """HIL_SENSOR of a frame with some fields changed."""
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
    player = Player(compiled=True)
    return player, until_inertial(player, stream)


@pytest.mark.parametrize("other", OTHERS)
def test_whatever_else_comes_is_left_alone(flying, other):
    player, data = flying
    wrong = OTHERS[other](data)
    before = memory(player.host)
    assert player.host.inertial_step(player.host.put(wrong)) is None
    assert memory(player.host) == before
    assert bytes(player.host.incoming[: len(wrong)]) == wrong


def test_what_is_not_left_alone_is_made(flying):
    """The witness of the test above."""
    player, data = flying
    before = memory(player.host)
    assert player.host.inertial_step(player.host.put(data)) is not None
    assert memory(player.host) != before


@pytest.mark.parametrize("fields", [0x1C0, 0x1A00, 0x1C0 | 0x1A00])
def test_compass_and_barometer_are_passed_over_until_a_reading_is_due(stream, fields):
    player = Player(compiled=True)
    host, data = player.host, until_inertial(player, stream)
    reading = sensor_like(data, fields_updated=0x3F | fields, abs_pressure=1000.0)
    host._inertial._moment["aids_us"] = _time_us(data)
    assert host.inertial_step(host.put(reading)) is None
    host._inertial._moment["aids_us"] = _time_us(data) + 1
    assert host.inertial_step(host.put(reading)) is not None


def test_while_the_simulator_is_silent_all_is_as_of_the_last_step(stream):
    player = Player(compiled=True)
    data = until_inertial(player, stream)
    player.hear(data)
    host = player.host
    assert host.vehicle.flight.now_us < _time_us(data)
    beat = common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    host.serve_while_paused([Addressed(Partner(GROUND_STATION, 0), beat)])
    flight = host.vehicle.flight
    assert flight.now_us == flight.state.time_us == _time_us(data)
    assert flight.sensor == HilParser(*TO_VEHICLE).push(data)[0]
    assert isinstance(flight.sensor, HilSensor)


def test_with_somebody_listening_every_step_is_whole(stream):
    player = Player(compiled=True)
    data = until_inertial(player, stream)
    host = player.host
    for messages in host.push(host.put(data)):
        host.step(messages, link_messages=[], link_active=(True, False))
    assert host.inertial_step(host.put(sensor_like(data, time_usec=_time_us(data) + STEP_US))) is None

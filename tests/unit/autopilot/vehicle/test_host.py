"""The vehicle host: handling of the simulator's bytes, of links in a pause, and of saved parameters."""

import contextlib
import errno
import os

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from vehicle_world import vehicle_config

from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.parameters import parameter_file
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from autopilot.vehicle.host import MOST_WAITING, Host
from netsim.wire.lockstep import BATCH_DELIVERED

SIMULATOR = Encoder(system=0, component=1)
ME, OTHER = Partner(GROUND_STATION, 0), Partner(GROUND_STATION, 1)
ACCEPTED, FAILED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_FAILED
IN_PROGRESS = common.MAV_RESULT_IN_PROGRESS


class Radio:
    """Counts the steps in which it is read."""

    def __init__(self):
        self.emptied_us = []

    def send(self, now_us, items):
        raise AssertionError((now_us, items))

    def receive(self, now_us):
        self.emptied_us.append(now_us)
        return []


@pytest.fixture
def radio():
    return Radio()


@pytest.fixture
def host(radio):
    with contextlib.closing(Host(vehicle_config(), radio)) as host:
        yield host


def sensor(time_us, *, delivered=True, number=0):
    at_rest = (0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 1013.25, 0.0, 0.0, 15.0)
    fields = 0x1FFF | (BATCH_DELIVERED if delivered else 0)
    return SIMULATOR.encode(common.MAVLink_hil_sensor_message(time_us, *at_rest, fields, number))


def gps(time_us):
    fix = (time_us, 3, 473979710, 85461630, 488_000, 100, 100, 0, 0, 0, 0, 0, 12)
    return SIMULATOR.encode(common.MAVLink_hil_gps_message(*fix))


def step(host, data, *link_messages):
    """Return the replies to each HIL_SENSOR in some bytes, and the messages for the links."""
    answers, links = [], []
    for messages in host.push(host.put(data)):
        answer, out = host.step(messages, link_messages=list(link_messages), link_active=(True, False))
        answers.append([message for message in Parser().push(answer) if "ACTUATOR" in message.get_type()])
        links += out
    return [message.time_usec for each in answers for message in each], links


def test_only_the_first_sensor_is_the_clock(host):
    data = sensor(3_000, number=1) + sensor(4_000) + sensor(7_000, number=1)
    assert step(host, data)[0] == [4_000]
    assert step(host, sensor(8_000))[0] == [8_000]


@pytest.mark.parametrize("again_us", [8_000, 4_000])
def test_a_repeated_or_earlier_time_leaves_messages_for_the_next_step(host, radio, again_us):
    """A simulator that pauses may repeat its last time, with a fix; a station sends a request meanwhile."""
    for time_us in (4_000, 8_000):
        assert step(host, sensor(time_us))[0] == [time_us]
    read = common.MAVLink_param_request_read_message(1, 1, b"MPC_XY_CRUISE", -1)
    request = Addressed(Partner(GROUND_STATION, 0), read)
    answered, links = step(host, gps(again_us) + sensor(again_us), request)
    assert answered == [again_us]
    assert links == []
    assert host.vehicle.flight.gps is None
    assert radio.emptied_us == [4_000, 8_000]
    answered, links = step(host, sensor(12_000))
    assert answered == [12_000]
    assert host.vehicle.flight.gps_us == 12_000
    assert [m.param_id for _, m in links if m.get_type() == "PARAM_VALUE"] in (
        ["MPC_XY_CRUISE"],
        [b"MPC_XY_CRUISE"],
    )
    assert radio.emptied_us == [4_000, 8_000, 12_000]
    _, links = step(host, sensor(16_000))
    assert not any(message.get_type() == "PARAM_VALUE" for _, message in links)


def test_the_radio_is_only_read_in_steps_with_received_items(host, radio):
    for time_us in range(4_000, 40_000, 4_000):
        assert step(host, sensor(time_us, delivered=time_us in {12_000, 32_000}))[0] == [time_us]
    assert radio.emptied_us == [12_000, 32_000]


@contextlib.contextmanager
def saving_host(path):
    with contextlib.closing(Host(replace(vehicle_config(), params_path=str(path)), None)) as host:
        step(host, sensor(4_000))
        yield host


def save(*, confirmation=0):
    command = common.MAVLink_command_long_message(
        1, 1, common.MAV_CMD_PREFLIGHT_STORAGE, confirmation, 1.0, *[0.0] * 6
    )
    return stamp(command, system=255, component=190)


def results(links, partner=ME):
    return [m.result for to, m in links if to == partner and m.get_type() == "COMMAND_ACK"]


def texts(links):
    """Return the texts sent on the ground station's link."""
    said = [m.text for to, m in links if to.link == GROUND_STATION and m.get_type() == "STATUSTEXT"]
    return [text.decode() if isinstance(text, bytes) else text for text in said]


def test_saving_is_in_progress_until_the_file_is_written(tmp_path):
    path = tmp_path / "uav.params"
    with saving_host(path) as host:
        host.vehicle.parameters.set("MPC_XY_P", 1.25)
        _, links = step(host, sensor(8_000), Addressed(ME, save()), Addressed(OTHER, save()))
        assert (results(links), results(links, OTHER)) == ([IN_PROGRESS], [IN_PROGRESS])
        assert parameter_file.load(path)["MPC_XY_P"] == 1.25
        _, links = step(host, sensor(12_000))
        assert (results(links), results(links, OTHER)) == ([ACCEPTED], [ACCEPTED])
        path.unlink()
        _, links = step(host, sensor(16_000), Addressed(ME, save(confirmation=1)))
        assert results(links) == [ACCEPTED]  # a repeated command is only acknowledged
        _, links = step(host, sensor(20_000))
        assert results(links) == []
        assert not path.exists()


def test_a_failed_save_is_reported_with_the_reason(tmp_path, capsys):
    with saving_host(tmp_path / "missing" / "uav.params") as host:
        _, links = step(host, sensor(8_000), Addressed(ME, save()))
        assert results(links) == [IN_PROGRESS]
        _, links = step(host, sensor(12_000), Addressed(ME, save(confirmation=1)))
        assert results(links) == [FAILED, FAILED]
        assert texts(links) == [f"Parameters not saved: {os.strerror(errno.ENOENT)}"]
    assert "parameters not saved" in capsys.readouterr().err


def test_in_a_pause_parameters_are_saved_and_acknowledged_immediately(tmp_path):
    path = tmp_path / "uav.params"
    with saving_host(path) as host:
        assert results(host.serve_while_paused([Addressed(ME, save())])) == [IN_PROGRESS, ACCEPTED]
        assert path.exists()
        assert not host.vehicle.messaging.take_save_request()


def test_requests_before_the_first_step_are_answered_in_it_and_limited_in_number(host):
    read = common.MAVLink_param_request_read_message(1, 1, b"MPC_XY_P", -1)
    for _ in range(2):
        assert host.serve_while_paused([Addressed(ME, read)] * MOST_WAITING) == []
    _, links = step(host, sensor(4_000))
    assert sum(m.get_type() == "PARAM_VALUE" for _, m in links) == MOST_WAITING
    assert sum(m.get_type() == "PARAM_VALUE" for _, m in host.serve_while_paused([Addressed(ME, read)])) == 1

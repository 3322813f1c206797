"""What a vehicle's host makes of what its simulator sends: nothing that came in is lost."""

import contextlib
import errno
import os
import sys

import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import vehicle_config

from autopilot.__main__ import _yield_to_the_simulator
from autopilot.host import Host
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.protocol.service import GROUND_STATION, Addressed, Partner

SIMULATOR = Encoder(system=0, component=1)


class Radio:
    """Notes when it is emptied."""

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


def sensor(time_us):
    at_rest = (0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 1013.25, 0.0, 0.0, 15.0)
    return SIMULATOR.encode(common.MAVLink_hil_sensor_message(time_us, *at_rest, 0x1FFF, 0))


def gps(time_us):
    fix = (time_us, 3, 473979710, 85461630, 488_000, 100, 100, 0, 0, 0, 0, 0, 12)
    return SIMULATOR.encode(common.MAVLink_hil_gps_message(*fix))


def step(host, data, *link_messages):
    """The answers to each HIL_SENSOR in some bytes, and what goes out on the links."""
    answers, links = [], []
    for messages in host.push(data):
        answer, out = host.step(messages, link_messages=list(link_messages), link_active=(True, False))
        answers.append([message for message in Parser().push(answer) if "ACTUATOR" in message.get_type()])
        links += out
    return [message.time_usec for each in answers for message in each], links


@pytest.mark.parametrize("again_us", [8_000, 4_000])
def test_a_time_that_is_repeated_or_goes_back_takes_nothing_that_the_next_step_is_for(host, radio, again_us):
    """A simulator that pauses may send its last instant again, with a fix; the ground asks meanwhile."""
    for time_us in (4_000, 8_000):
        assert step(host, sensor(time_us))[0] == [time_us]
    asking = common.MAVLink_param_request_read_message(1, 1, b"MPC_XY_CRUISE", -1)
    asked = Addressed(Partner(GROUND_STATION, 0), asking)
    answered, links = step(host, gps(again_us) + sensor(again_us), asked)
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


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the policy")
def test_a_sandbox_that_forbids_the_scheduling_policy_does_not_keep_a_vehicle_from_flying(monkeypatch):
    asked = []

    def refuse(pid, policy, param):
        asked.append((pid, policy, param.sched_priority))
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    _yield_to_the_simulator()
    assert asked == [(0, os.SCHED_BATCH, 0)]

"""Swarms of real ArduPilots: skipped without the SITL program in the variable COFLIGHT_ARDUPILOT_PROGRAM."""

import contextlib
import json
import os
import socket
import time

import psutil
import pytest
from external_swarms import free_base, heights_m
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from harness.launch.process_commands import application, uav
from harness.launch.swarm import Swarm
from harness.simulator.messages import ApplicationLost, VehicleLost

PROGRAM = os.environ.get("COFLIGHT_ARDUPILOT_PROGRAM")
WALL_LIMIT_S = 240.0
LAND, GUIDED = 9, 4
pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(PROGRAM is None, reason="COFLIGHT_ARDUPILOT_PROGRAM is not set: no real ArduPilot"),
    pytest.mark.timeout(600),
]


@pytest.fixture
def swarm(tmp_path):
    """Return a factory of swarms of real ArduPilots in the article's wind, in rows of two."""

    def make(agents, *overrides, name="run", port_offset="auto", **kwargs):
        return Swarm(
            "article", agents=agents, out=tmp_path / name, wall_limit_s=WALL_LIMIT_S, port_offset=port_offset,
            ports="scenario", **kwargs,
            overrides=[
                "autopilot.kind=ardupilot", f"autopilot.ardupilot_program='{PROGRAM}'", "formation.columns=2",
                *overrides,
            ],
        )  # fmt: skip

    return make


def program_of(flown, instance):
    return psutil.Process(flown._processes.ready[uav(instance)].pid)


def test_ardupilots_hold_the_shape_and_the_heights_also_after_rests(swarm):
    with swarm(3) as flown:
        flown.run_for(1.0)
        time.sleep(2.5)  # they repeat their packets meanwhile
        formed_s = flown.run_until_formed(timeout_s=120.0).t_s
        programs = [program_of(flown, i) for i in range(3)]
        time.sleep(2.5)
        truth = flown.run_for(15.0)
        assert {vehicle.mode for vehicle in truth.vehicles} == {"Guided"}
        summary = flown.summary(draw=False)
    assert flown.leftovers() == []
    assert not any(program.is_running() for program in programs)
    assert formed_s < 80.0
    assert summary["collisions"] == 0
    assert summary["formation_rms_m"]["shape"] < 0.4
    assert heights_m(flown.path, formed_s + 2.0) == pytest.approx([10.0] * 3, abs=0.6)
    manifest = json.loads((flown.path / "manifest.json").read_text())
    details = {process["name"]: process["details"] for process in manifest["processes"]}
    assert {details[application(i)]["malformed_bytes"] for i in range(3)} == {0}


def test_a_killed_ardupilot_and_application_are_named_and_the_others_go_on(swarm):
    with swarm(3, "onboard.localisation=gps") as flown:
        flown.run_until(lambda truth: min(v.pos_ned_m[2] for v in truth.vehicles) < -3.0, timeout_s=90.0)
        program_of(flown, 2).kill()
        psutil.Process(flown.pids[application(1)]).kill()
        truth = flown.run_for(5.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True, True, False]
        assert truth.vehicles[1].phase == ""
        assert truth.vehicles[1].armed
    losses = [event for event in flown.events if isinstance(event, VehicleLost)]
    assert [(event.instance, event.reason) for event in losses] == [(2, "its connection closed")]
    # the killed vehicle's application had no autopilot any more, and is no loss of its own
    assert 1 in {event.instance for event in flown.events if isinstance(event, ApplicationLost)}
    assert flown.leftovers() == []


def test_two_swarms_of_ardupilots_fly_at_once(swarm):
    with swarm(2, "onboard.localisation=gps", name="one") as first:
        first.run_for(1.0)
        with swarm(2, "onboard.localisation=gps", name="two") as second:
            assert second.scenario.ports.simulator_tcp != first.scenario.ports.simulator_tcp
            for flown in (second, first):
                flown.run_until(lambda truth: all(v.armed for v in truth.vehicles), timeout_s=90.0)
    assert first.leftovers() == second.leftovers() == []


@pytest.mark.parametrize("count", [2, 40])
def test_a_parameter_that_ardupilot_does_not_have_is_named_and_no_other(swarm, count):
    """The others are parameters of its 16 output channels and of its modes."""
    names = [f"SERVO{i}_{what}" for i in range(1, 15) for what in ("TRIM", "MIN", "MAX")][: count - 1]
    values = {"MIN": 1000, "TRIM": 1500, "MAX": 2000}
    given = [f"autopilot.params.{name}={values[name.split('_')[1]]}" for name in names]
    with swarm(1, "autopilot.params.NO_SUCH=1", *given, "onboard.enabled=false") as flown:
        flown.run_for(30.0)
        texts = [
            event.text for event in flown.events if "has no such parameter" in getattr(event, "text", "")
        ]
    assert texts == ["autopilot.params.NO_SUCH: this ArduPilot has no such parameter"]


class Station:
    """A ground station at the port to which a vehicle sends."""

    def __init__(self, port, system):
        self.system = system
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", port))
        self.sock.settimeout(0.0)
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.vehicle = None

    def receive(self):
        messages = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self.vehicle = self.sock.recvfrom(65_536)
                messages += self.mav.parse_buffer(data) or []
        return [message for message in messages if message.get_srcComponent() == 1]

    def command(self, flown, number, *params):
        """Send a command until it is acknowledged; returns the result."""
        given = (*params, *[0.0] * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(self.system, 1, number, 0, *given)
        for _ in range(20):
            if self.vehicle is not None:
                self.sock.sendto(message.pack(self.mav), self.vehicle)
            flown.run_for(0.5)
            for reply in self.receive():
                if reply.get_type() == "COMMAND_ACK" and reply.command == number:
                    return reply.result
        raise AssertionError(f"no acknowledgement of {number}")


def test_a_ground_station_lands_a_vehicle_and_arms_it_again(swarm):
    base = free_base(8)
    ports = [f"ports.gcs_remote_udp={base}", f"ports.companion_remote_udp={base + 1}"]
    station = Station(base, 1)
    # in the article's wind ArduPilot requests an angle against it also on the ground, and detects no landing
    calm = ("wind.mean_n=0.0",)
    flown = swarm(1, "onboard.localisation=gps", *calm, *ports, port_offset=0)
    with contextlib.closing(station.sock), flown:
        flown.run_until_formed(timeout_s=120.0)
        station.receive()
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        assert station.command(flown, mavlink.MAV_CMD_DO_SET_MODE, custom, LAND) == 0
        flown.run_until(lambda truth: not truth.vehicles[0].armed, timeout_s=60.0)
        truth = flown.run_for(3.0)
        assert (truth.vehicles[0].mode, truth.vehicles[0].phase) == ("Land", "landed")
        assert truth.vehicles[0].pos_ned_m[2] > -0.3
        assert station.command(flown, mavlink.MAV_CMD_DO_SET_MODE, custom, GUIDED) == 0
        assert station.command(flown, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == 0
        flown.run_until(lambda truth: truth.vehicles[0].armed, timeout_s=5.0)  # the motors turn later
        assert station.command(flown, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 4.0) == 0
        truth = flown.run_until(lambda truth: truth.vehicles[0].pos_ned_m[2] < -3.0, timeout_s=20.0)
        # the application leaves it to the ground station
        assert (truth.vehicles[0].mode, truth.vehicles[0].phase) == ("Guided", "landed")
    assert flown.leftovers() == []

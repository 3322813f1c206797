"""Starts of programs on vehicles, settings of their process, and the vehicles that can be entered."""

import os

import msgspec
import psutil
import pytest

from autopilot.parameters.config import AutopilotConfig, LinksConfig, RadioEndpoint
from autopilot.parameters.onboard_config import OnboardConfig
from harness.launch.vehicle_network import (
    ProgramStarts,
    companion_link,
    network_config,
    read_holders,
    write_holders,
)
from harness.scenario.programs import VehicleProgram
from harness.scenario.scenario import PortsConfig, Scenario
from harness.simulator.messages import Formed, Progress, VehicleTruth

PROGRAMS = (
    VehicleProgram(name="first", command=("one", "{uav}"), start="at_once", uav=(2, 0)),
    VehicleProgram(name="second", command=("two",), start="armed"),
    VehicleProgram(name="third", command=("three",), start="formed", uav=1),
)
RUN = "7f"
ANY = "0.0.0.0"  # noqa: S104  a setting
SCENARIO = Scenario(name="programs", agents=3, programs=PROGRAMS)
FORMED = Formed(time_us=9_000_000)


def progress(*armed):
    """Return a message with these vehicles armed."""
    at_rest = {"pos_ned_m": (0.0,) * 3, "vel_ned_m_s": (0.0,) * 3, "q_ned_frd": (1.0, 0.0, 0.0, 0.0)}
    vehicles = tuple(
        VehicleTruth(alive=True, armed=uav in armed, mode="", phase="", error_m=0.0, **at_rest)
        for uav in range(3)
    )
    return Progress(time_us=0, wall_s=0.0, channel_busy_fraction=0.0, vehicles=vehicles)


def test_each_program_is_started_once_when_it_is_due():
    starts = ProgramStarts(SCENARIO)
    assert starts.before_flight() == (0, 1)  # on vehicles 2 and 0
    assert starts.due(progress()) == ()
    assert starts.due(progress(1)) == (3,)
    assert starts.due(progress(0, 1, 2)) == (2, 4)
    assert starts.due(progress(0, 1, 2)) == ()
    assert starts.due(FORMED) == (5,)
    assert starts.due(FORMED) == ()
    assert starts.before_flight() == ()


def test_settings_name_the_vehicle_of_each_start(tmp_path):
    endpoint = RadioEndpoint(locator="unixsock-stream//radio", password=RUN)
    config = network_config(SCENARIO, endpoint, run_id=RUN, logs=tmp_path)
    assert config.stations == (0, 1, 2)
    assert [(each.name, each.station) for each in config.programs] == [
        ("first", 2), ("first", 0), ("second", 0), ("second", 1), ("second", 2), ("third", 1),
    ]  # fmt: skip
    assert config.programs[0].command == ("one", "2")
    assert config.programs[0].log_path == str(tmp_path / "uav-2-first.log")
    assert config.window_packets == SCENARIO.radio.queue_frames
    assert config.password == RUN


def test_only_living_processes_can_be_entered(tmp_path):
    path = tmp_path / "network.json"
    write_holders(path, {"0": os.getpid(), "1": os.getppid()})
    assert read_holders(path) == {0: os.getpid(), 1: os.getppid()}
    assert path.stat().st_mode & 0o077 == 0
    # the number of another process, started at another time
    content = msgspec.json.decode(path.read_bytes())
    content["1"]["started_s"] -= 1.0
    path.write_bytes(msgspec.json.encode(content))
    assert read_holders(path) == {0: os.getpid()}
    content["0"]["pid"] = max(psutil.pids()) + 1_000_000
    path.write_bytes(msgspec.json.encode(content))
    assert read_holders(path) == {}


def test_content_of_another_kind_is_an_error(tmp_path):
    path = tmp_path / "network.json"
    path.write_text("[]")
    with pytest.raises(msgspec.DecodeError):
        read_holders(path)


def link_of(uav, *, agents=3, **settings):
    link = companion_link(Scenario(name="links", agents=agents, programs=PROGRAMS, **settings), uav)
    return None if link is None else (
        f"{link.autopilot_host}:{link.autopilot_port}", f"{link.companion_host}:{link.companion_port}"
    )  # fmt: skip


def test_each_own_autopilot_has_a_link_to_its_programs():
    assert link_of(2) == ("127.0.0.1:14582", "127.0.0.1:14542")
    # the port is the ground station's, or a vehicle's own
    assert link_of(10, agents=50) == ("127.0.0.1:14590", "127.0.0.1:0")
    assert link_of(40, agents=50) == ("127.0.0.1:14620", "127.0.0.1:0")
    free = PortsConfig(companion_local_udp=0, companion_remote_udp=0)
    assert link_of(0, ports=free) == ("127.0.0.1:0", "127.0.0.1:0")
    everywhere = LinksConfig(host=ANY)
    assert link_of(0, links=everywhere) == ("127.0.0.1:14580", "127.0.0.1:14540")
    assert link_of(0, links=LinksConfig(host=ANY, companion_host="10.0.0.9")) is None


def test_links_of_other_autopilots_are_of_their_applications():
    autopilot = AutopilotConfig(kind="px4", px4_build="/px4", px4_vehicles=(1,))
    assert link_of(0, autopilot=autopilot) is not None
    assert link_of(1, autopilot=autopilot) is None
    without = OnboardConfig(enabled=False)
    assert link_of(1, autopilot=autopilot, onboard=without) == ("127.0.0.1:14581", "127.0.0.1:14541")
    autopilot = AutopilotConfig(kind="ardupilot", ardupilot_program="/arducopter")
    assert link_of(1, autopilot=autopilot, onboard=without) == ("127.0.0.1:0", "127.0.0.1:14541")

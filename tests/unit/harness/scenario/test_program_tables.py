"""Programs on vehicles in scenario files: what is read, and lines for what is wrong."""

import pytest

from harness.launch.swarm import SetupError, Swarm
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load

TEXT = """
agents = 3
[[programs]]
name = "exchange"
uav = [0, 2]
command = ["python3", "exchange.py", "--id", "{uav}"]
environment = {NAME = "uav-{uav}"}
start = "formed"
[[programs]]
name = "router"
uav = 1
command = ["babeld", "wlan0"]
"""


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "network.toml"
    path.write_text(TEXT)
    return path


def test_programs_are_read_with_the_vehicle_in_their_words(path):
    scenario = load(path)
    exchange, router = scenario.programs
    assert scenario.has_network
    assert exchange.vehicles(3) == (0, 2)
    assert router.vehicles(3) == (1,)
    assert exchange.command_of(2) == ("python3", "exchange.py", "--id", "2")
    assert exchange.environment_of(2) == {"NAME": "uav-2"}
    assert exchange.folder == str(path.parent)


def test_program_runs_on_all_vehicles_by_default(path):
    scenario = load(path, ["programs.1.uav=all"])
    assert scenario.programs[1].vehicles(3) == (0, 1, 2)


def test_scenario_without_programs_has_no_network(path):
    path.write_text("agents = 2\n")
    assert not load(path).has_network
    assert load(path, ["network.enabled=true"]).has_network


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("programs.0.uav=3", "programs[0].uav: there is no UAV 3 among 3"),
        ("programs.0.uav=[1, 1]", "programs[0].uav: expected one or more UAVs, each once"),
        ("programs.0.uav=[]", "programs[0].uav: expected one or more UAVs, each once"),
        ('programs.0.environment={A = "a\\u0000"}', "programs[0].environment"),
        ('programs.0.folder="a\\u0000"', "programs[0].folder"),
        ("programs.1.name=exchange", "programs[1].name: programs[0] is called exchange too"),
        ("programs.0.command=[]", "programs[0].command: expected `array` of length >= 1"),
        ("programs.0.start=later", "programs[0].start: invalid enum value 'later'"),
        ("programs.0.folder=absent", "programs[0].folder: there is no folder"),
        (
            "ports.radio_link=tcp",
            "ports.radio_link: network namespaces reach the emulator by its Unix socket",
        ),
    ],
)
def test_wrong_field_is_named(path, override, line):
    with pytest.raises(ScenarioError) as caught:
        load(path, [override])
    assert line in str(caught.value)


def test_programs_refuse_a_speed_without_wall_time(path, tmp_path):
    with pytest.raises(SetupError, match="speed max"):
        Swarm(path, out=tmp_path / "run")

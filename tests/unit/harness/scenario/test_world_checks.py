"""Sensors and faults of a scenario are checked when it is read; an error is one line with the field."""

import sys

import msgspec
import pytest

from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load

SENSOR, FAULT = "[[sensors.extra]]\n{}\n", '[[faults]]\nkind = "user"\nuav = 1\n{}\n'
PX4 = '[autopilot]\nkind = "px4"\npx4_build = "/build"\n'
ARDUPILOT = '[autopilot]\nkind = "ardupilot"\nardupilot_program = "/arducopter"\n'
MODULE = """
from coflight import Effects

class Level:
    columns, period_us, delay_us = ("level_m",), 40_000, 0
    def __init__(self, context):
        pass
    def sample(self, inputs):
        return (-inputs.pos_ned_m[2],)

class Broken(Level):
    def sample(self, inputs):
        return (1.0, 2.0)

class Push:
    def __init__(self, context):
        pass
    def update(self, inputs, since_s):
        return Effects(force_ned_n=(1.0, 0.0, 0.0))
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "beside_scenario", raising=False)
    (tmp_path / "beside_scenario.py").write_text(MODULE, encoding="utf-8")

    def read(text, overrides=()):
        path = tmp_path / "own.toml"
        path.write_text(f"agents = 2\nformation = {{ columns = 2 }}\n{text}", encoding="utf-8")
        return load(path, overrides)

    yield read
    sys.modules.pop("beside_scenario", None)


def test_modules_beside_the_scenario_are_found_and_their_folder_is_kept(read, tmp_path):
    text = SENSOR.format('model = "beside_scenario:Level"') + FAULT.format('model = "beside_scenario:Push"')
    scenario = read(text)
    assert scenario.sensors.extra[0].title == "Level"
    assert {scenario.sensors.extra[0].folder, scenario.faults[0].folder} == {str(tmp_path)}
    again = msgspec.json.decode(msgspec.json.encode(scenario), type=type(scenario))
    assert again == scenario


def test_overrides_reach_the_settings(read):
    text = SENSOR.format('model = "range_finder"')
    scenario = read(text, ["sensors.extra.0.settings.max_m=20", "sensors.extra.0.uavs=[1]"])
    assert scenario.sensors.extra[0].settings == {"max_m": 20}
    assert scenario.sensors.extra[0].vehicles(2) == (1,)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (SENSOR.format('model = "range_finder"\nuavs = [2]'), r"sensors\.extra\[0\]\.uavs: 2 is none of 2"),
        (
            SENSOR.format('model = "range_finder"') * 2,
            r"sensors\.extra\[1\]\.name: 'range_finder' is also that of sensors\.extra\[0\]; expected",
        ),
        (SENSOR.format('model = "beside_scenario:Broken"'), r"sensors\.extra\[0\]\.model .*2 values"),
        (SENSOR.format('model = "range_finder"\nrate_hz = 3'), r"sensors\.extra\[0\]: unknown key `rate_hz`"),
        (SENSOR.format('model = "range_finder"\nname = "a b"'), r"sensors\.extra\[0\]\.name: "),
        (FAULT.format('model = "beside_scenario:Pusher"'), r"faults\[0\]\.model: .* did you mean .*:Push\?"),
        (FAULT.format(""), r"faults\[0\]: object missing required field `model`"),
        (
            SENSOR.format('model = "range_finder"') + ARDUPILOT,
            r"sensors\.extra\[0\]\.uavs: range_finder cannot be on UAV 0, as an ArduPilot takes none",
        ),
    ],
)  # fmt: skip
def test_an_error_is_one_line_with_file_and_field(read, tmp_path, text, line):
    with pytest.raises(ScenarioError, match=rf"^{tmp_path / 'own.toml'}: {line}") as caught:
        read(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("model", ['"range_finder"', '"uwb_tag"\nsettings = { vehicles = true }'])
def test_sensors_are_beside_a_px4_too(read, model):
    text = SENSOR.format(f"model = {model}") + PX4
    assert read(text).sensors.extra[0].vehicles(2) == (0, 1)

"""The examples of docs/how-to/sensors-and-faults.md are complete, and do what the page says. 2 s."""

import math
import re
import sys

import numpy as np
import pytest
from paths import ROOT
from world_models import models, state_of

from harness.scenario.scenario_file import load

PAGE = (ROOT / "docs" / "how-to" / "sensors-and-faults.md").read_text(encoding="utf-8")


@pytest.fixture
def scenarios(tmp_path):
    """Write each module to the file that the text before it names; return the scenarios of the page."""
    found = re.findall(r"`(\w+)\.py`, complete[^`]*```python\n(.*?)```", PAGE, re.DOTALL)
    assert [name for name, _ in found] == ["thermometer", "spoofing"]
    for name, text in found:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    tables = [text for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL) if "project" not in text]
    read = []
    for number, text in enumerate(tables):
        path = tmp_path / f"scenario{number}.toml"
        path.write_text(text if "agents" in text else f"agents = 4\nformation.columns = 2\n{text}")
        read.append(load(path))
    yield read
    for name, _ in found:
        sys.modules.pop(name, None)


def test_the_examples_measure_and_act(scenarios):
    shipped, thermometer, spoofing = scenarios
    assert [each.title for each in shipped.sensors.extra] == ["range_finder", "uwb"]
    assert len(shipped.sensors.boxes) == 1
    world, state = models(4), state_of([(0.0, 0.0, -100.0)] * 4)
    (sensor, *_) = world.sensors(thermometer.sensors.extra)
    readings_degc = np.array([sensor.sample(state)[0] for _ in range(400)])
    assert readings_degc.mean() == pytest.approx(22.0 - 0.65, abs=4 * 0.1 / 20.0)
    fault = world.fault(spoofing.faults[0], 0, 1)
    quarter, before = fault.update(state, 15.0), fault.update(state, 14.999)
    assert quarter.gps_offset_ned_m == pytest.approx((5.0, 5.0, 0.0))
    moved = np.subtract(quarter.gps_offset_ned_m, before.gps_offset_ned_m) / 0.001
    assert quarter.gps_velocity_offset_ned_m_s == pytest.approx(tuple(moved), abs=1e-4)
    assert math.hypot(*quarter.gps_velocity_offset_ned_m_s) == pytest.approx(5.0 * math.tau / 60.0)

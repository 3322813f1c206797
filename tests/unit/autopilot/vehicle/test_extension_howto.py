"""The examples of docs/how-to/autopilot-extensions.md are complete, and fly."""

import math
import re
import sys

import pytest
from msgspec.structs import replace
from paths import ROOT
from pymavlink.dialects.v20 import common
from vehicle_world import Flight, vehicle_config

from autopilot.mavlink.modes import FlightMode
from autopilot.parameters.config import AutopilotConfig

PAGE = (ROOT / "docs" / "how-to" / "autopilot-extensions.md").read_text(encoding="utf-8")
SET_MODE, DEBUG = common.MAV_CMD_DO_SET_MODE, common.MAVLink_debug_message


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Write each example to the file that the text before it names."""
    found = re.findall(r"`(\w+)\.py`, complete[^`]*```python\n(.*?)```", PAGE, re.DOTALL)
    for name, text in found:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield [name for name, _ in found]
    for name, _ in found:
        sys.modules.pop(name, None)


def test_the_examples_fly_together(modules):
    assert modules == ["hover_control", "spiral", "odometer"]
    spiral = "spiral:SpiralMode"
    autopilot = AutopilotConfig(
        controller="hover_control:HoverController",
        modes=(spiral,),
        services=("odometer:Odometer",),
        mode_settings={spiral: {"radius_max_m": 4.0}},
    )
    with Flight(replace(vehicle_config(), autopilot=autopilot)) as flight:
        commander, state = flight.vehicle.commander, flight.vehicle.flight.state
        flight.take_off(5.0)
        centre_ned_m = state.pos_ned_m.copy()
        assert flight.command(SET_MODE, 1.0, 4.0, 11.0) == common.MAV_RESULT_ACCEPTED
        furthest_m = [0.0]

        def holds():
            place_ned_m = flight.vehicle.flight.state.pos_ned_m
            furthest_m[0] = max(furthest_m[0], math.dist(place_ned_m[:2], centre_ned_m[:2]))
            return commander.mode is FlightMode.HOLD

        assert flight.run(60.0, until=holds)
        assert furthest_m[0] == pytest.approx(4.0, abs=0.7)
        assert flight.height_m == pytest.approx(5.0, abs=1.0)
        since = len(flight.received)
        flight.run(1.1)
        (value,) = [m for _, m in flight.received[since:] if m.get_type() == "NAMED_VALUE_FLOAT"][:1]
        assert 20.0 < value.value < 45.0  # two turns with a mean radius of 2 m are 25 m, after the climb
        flight.send(DEBUG(0, 0, 0.0))
        flight.step()
        assert flight.texts()[-1] == "Odometer reset"
        assert flight.command(common.MAV_CMD_NAV_LAND) == common.MAV_RESULT_ACCEPTED
        assert flight.run(40.0, until=lambda: not commander.armed)

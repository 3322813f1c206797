"""The examples of docs/how-to/radio-models.md are complete, and give the powers of their formulas."""

import re
import sys

import numpy as np
import pytest
from netsim_swarm import make_links
from paths import ROOT

from harness.scenario.scenario_file import load
from netsim.phy.path_loss import friis_loss_db
from netsim.phy.propagation import Trajectories

PAGE = (ROOT / "docs" / "how-to" / "radio-models.md").read_text(encoding="utf-8")
LOW, HIGH = (0.0, 0.0, -10.0), (0.0, 0.0, -50.0)


@pytest.fixture
def folder(tmp_path):
    """Return a folder with each example in the file that the text before it names."""
    found = re.findall(r"`(\w+)\.py`, complete[^`]*```python\n(.*?)```", PAGE, re.DOTALL)
    for name, text in found:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    yield tmp_path
    for name, _ in found:
        del sys.modules[name]


def excess_db(scenario, place_ned_m, other_ned_m):
    """Loss of a link over that of free space."""
    trajectories = Trajectories(2)
    links = make_links(scenario.radio, trajectories, 2, 1)
    trajectories.set(0, [place_ned_m, other_ned_m], np.zeros((2, 3)))
    distance_m = float(np.linalg.norm(np.subtract(place_ned_m, other_ned_m)))
    power_dbm = 10.0 * np.log10(links.row(0, 0).powers_mw[1])
    return scenario.radio.tx_power_dbm - power_dbm - friis_loss_db(distance_m, scenario.radio.frequency_mhz)


def test_the_examples_are_path_losses(folder):
    tables = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    scenarios = []
    for number, text in enumerate(tables[:2]):
        file = folder / f"{number}.toml"
        file.write_text(text, encoding="utf-8")
        scenarios.append(load(file))
    street, air = scenarios
    assert excess_db(street, LOW, (30.0, 0.0, -10.0)) == pytest.approx(0.0, abs=0.05)
    assert excess_db(street, LOW, (400.0, 0.0, -10.0)) == pytest.approx(20.0, abs=0.05)
    assert excess_db(air, LOW, (50.0, 0.0, -10.0)) == pytest.approx(5.0, abs=0.05)
    assert excess_db(air, LOW, HIGH) == pytest.approx(0.0, abs=0.05)

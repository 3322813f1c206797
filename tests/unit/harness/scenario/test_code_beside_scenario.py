"""Modules of the autopilot's extensions are looked up beside the scenario, as those of applications are."""

import shutil
import sys

import msgspec
import pytest
from paths import SUPPORT

from autopilot.vehicle.extensions import load_extensions
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load

MODULE = "only_beside_the_scenario"
CODE = """
[autopilot]
controller = "{module}:{controller}"
modes = ["{module}:ClimbMode"]
services = ["{module}:Counter"]
"""


@pytest.fixture
def read(tmp_path):
    def read(controller="CascadeAgain"):
        shutil.copy(SUPPORT / "user_extensions.py", tmp_path / f"{MODULE}.py")
        path = tmp_path / "own.toml"
        path.write_text(CODE.format(module=MODULE, controller=controller), encoding="utf-8")
        return load(path)

    yield read
    sys.modules.pop(MODULE, None)


def test_modules_are_found_and_their_folder_reaches_the_processes_of_vehicles(read, tmp_path):
    scenario = read()
    assert scenario.autopilot.folder == str(tmp_path)
    sys.modules.pop(MODULE)  # as in a process of its own
    again = msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario)
    found = load_extensions(again.autopilot)
    classes = [found.controller.kind, found.modes[0].kind, found.services[0].kind]
    assert {each.__module__ for each in classes} == {MODULE}


def test_a_class_that_is_missing_there_is_one_line(read):
    with pytest.raises(ScenarioError, match=r"own\.toml: autopilot\.controller: .*only_beside_the_scenario"):
        read("Missing")


def test_without_code_there_is_no_folder(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text("agents = 2", encoding="utf-8")
    assert load(path).autopilot.folder == ""

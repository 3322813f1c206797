"""Settings files of a run's processes, and what else a run's folder holds before the flight."""

import msgspec
import pytest
from paths import SCENARIOS

from autopilot.onboard.radio.beacon_dissector import dissector
from harness.records.run_folder import RunFolder
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from netsim.model.config import ServerConfig
from netsim.wire.messages import DEFAULT_PORT

ARTICLE = SCENARIOS / "article.toml"


def radio_config(folder, *settings):
    scenario = load(ARTICLE, ["run.epoch_utc=2030-05-06T07:08:09.5Z", *settings])
    path = folder.write_radio_config(scenario, folder.radio_config(scenario, run_id="test"))
    return msgspec.json.decode(path.read_bytes(), type=ServerConfig)


@pytest.mark.parametrize("kind", ["true", "medium", "receivers"])
def test_a_capture_has_the_epoch_of_the_scenario_and_a_dissector_beside_it(kind, tmp_path):
    folder = RunFolder(tmp_path / "run").create()
    config = radio_config(folder, f"radio.capture={kind}")
    assert config.capture_path == str(tmp_path / "run" / "radio.pcapng")
    assert config.epoch_unix_us == 1_904_281_689_500_000
    assert (tmp_path / "run" / "coflight_beacon.lua").read_text() == dissector(DEFAULT_PORT)


def test_a_run_without_a_capture_has_no_dissector(tmp_path):
    folder = RunFolder(tmp_path / "run").create()
    assert radio_config(folder).capture_path is None
    assert radio_config(folder, "radio.capture=false").capture_path is None
    assert not (tmp_path / "run" / "coflight_beacon.lua").exists()


def test_another_kind_of_capture_is_refused_with_its_path():
    with pytest.raises(ScenarioError, match=r"radio\.capture"):
        load(ARTICLE, ["radio.capture=stations"])

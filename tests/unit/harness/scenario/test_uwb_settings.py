"""UWB ranging radios in a scenario: their settings, and ones that contradict each other."""

import pytest
from paths import SCENARIOS

from harness.records.run_folder import RunFolder
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from netsim.uwb.time_of_flight import distance_std_m

UWB = ["onboard.ranging_radio=uwb"]


def scenario(*overrides):
    return load(SCENARIOS / "article.toml", overrides)


def test_the_emulator_and_the_vehicles_have_the_settings(tmp_path):
    chosen = scenario(*UWB, "uwb.method=ss", "uwb.channel=9")
    folder = RunFolder(tmp_path)
    assert folder.radio_config(chosen, run_id="run").uwb == chosen.uwb
    assert chosen.uwb.channel == 9
    config = chosen.vehicle_config(0, run_id="run", radio_endpoint=None, log_path=None)
    assert config.devices.ftm_trip_std_m == distance_std_m(chosen.uwb)


def test_without_them_the_802_11_radio_ranges(tmp_path):
    chosen = scenario("uwb.channel=9")
    assert RunFolder(tmp_path).radio_config(chosen, run_id="run").uwb is None
    config = chosen.vehicle_config(0, run_id="run", radio_endpoint=None, log_path=None)
    assert config.devices.ftm_trip_std_m > 2.0 * distance_std_m(chosen.uwb)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["uwb.reply_time_us=100"], r"uwb\.reply_time_us: 100 us; .*expected more"),
        (["uwb.slot_us=1000"], r"uwb\.slot_us: 1000 us; .*expected at least that"),
        (["uwb.request_timeout_us=5000"], r"uwb\.request_timeout_us: 5000 us; the slots of 8 stations"),
        (["uwb.channel=3"], r"uwb\.channel"),
    ],
)
def test_contradictory_settings_are_one_line(overrides, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        scenario(*UWB, *overrides)
    assert "\n" not in str(caught.value)


def test_settings_of_radios_that_are_not_used_may_contradict():
    assert scenario("uwb.slot_us=1000").uwb.slot_us == 1000

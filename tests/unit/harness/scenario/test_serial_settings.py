"""Serial modems in a scenario: their ground station, and settings that contradict each other."""

import pytest
from paths import SCENARIOS

from harness.launch.ground_process import settings
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from netsim.transport.guest_access import GuestLogin

STATIONS = "stations=[{name='north', pos_ned_m=[9.0, 0.0, 0.0]}, {name='south', pos_ned_m=[-9.0, 0.0, 0.0]}]"
SERIAL = ["agents=4", "links.telemetry=serial-radio", STATIONS]


def scenario(*overrides):
    return load(SCENARIOS / "article.toml", overrides)


def test_each_vehicle_has_a_pair_of_modems_with_the_first_ground_station():
    chosen = scenario(*SERIAL, "serial_radio.air_rate_kbps=16", "stations.0.antenna_gain_dbi=6")
    assert chosen.serial_pairs.ground_station == 4
    assert chosen.serial_pairs.settings.air_rate_kbps == 16
    assert [guest.name for guest in chosen.channel.guests] == ["north"]
    config = chosen.vehicle_config(2, run_id="run", radio_endpoint=None, log_path=None)
    assert config.serial_modem
    assert config.ground_stations == {"north": 4}
    login = GuestLogin(station=4, user="user", password="")
    assert settings(chosen, 0, login, endpoint="", run_id="run").serial_modems


def test_other_telemetry_has_no_modems():
    for telemetry in ("wire", "radio"):
        chosen = scenario(*SERIAL, f"links.telemetry={telemetry}")
        assert chosen.serial_pairs is None
        config = chosen.vehicle_config(0, run_id="run", radio_endpoint=None, log_path=None)
        assert not config.serial_modem


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["links.telemetry=serial-radio"], r'links\.telemetry: "serial-radio" needs a ground station'),
        (
            [*SERIAL, "autopilot.kind=px4", "autopilot.px4_build=build"],
            r'links\.telemetry: .*UAV 0 is flown by px4.*expected "wire"',
        ),
        (
            [*SERIAL, "stations.0.tx_power_dbm=1"],
            r"stations\[0\]\.tx_power_dbm: .*expected serial_radio\.tx_power_dbm",
        ),
        ([*SERIAL, "serial_radio.air_rate_kbps=2"], r"serial_radio\.air_rate_kbps: .*expected one of 4,"),
        (
            [*SERIAL, "serial_radio.air_rate_kbps=4", "serial_radio.max_window_ms=10"],
            r"serial_radio\.max_window_ms: no packet fits into 10 ms",
        ),
    ],
)
def test_settings_that_contradict_each_other_are_one_line(overrides, line):
    with pytest.raises(ScenarioError, match=line) as error:
        scenario(*overrides)
    assert len(str(error.value).splitlines()) == 1

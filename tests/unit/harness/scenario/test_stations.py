"""Ground stations of a scenario: numbers and places on the channel, ports, and settings that are refused."""

import pytest
from paths import SCENARIOS

from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load

STATIONS = "stations=[{name='north', pos_ned_m=[9.0, 0.0, 0.0]}, {name='south', pos_ned_m=[-9.0, 0.0, -1.0]}]"
RADIO = ["agents=4", "links.telemetry=radio", STATIONS]
GUEST = "radio.guests=[{name='car', pos_ned_m=[0.0, 0.0, 0.0]}]"


def scenario(*overrides):
    return load(SCENARIOS / "article.toml", overrides)


def test_ground_stations_follow_vehicles_and_guests():
    chosen = scenario(*RADIO, GUEST, "stations.1.antenna_height_m=5", "stations.1.tx_power_dbm=20")
    assert [(each.name, each.pos_ned_m) for each in chosen.channel.guests] == [
        ("car", (0.0, 0.0, 0.0)), ("north", (9.0, 0.0, -2.0)), ("south", (-9.0, 0.0, -6.0)),
    ]  # fmt: skip
    assert [(each.station, each.tx_power_dbm) for each in chosen.channel.stations] == [(6, 20.0)]
    config = chosen.vehicle_config(0, run_id="r", radio_endpoint=None, log_path=None)
    assert config.ground_stations == {"north": 5, "south": 6}


def test_telemetry_by_wire_leaves_the_channel_without_ground_stations():
    chosen = scenario(*RADIO, "links.telemetry=wire")
    assert chosen.channel == chosen.radio
    assert chosen.vehicle_config(0, run_id="r", radio_endpoint=None, log_path=None).ground_stations == {}


def test_ports_of_a_second_ground_station_follow_those_of_the_first():
    chosen = scenario(*RADIO, "ports.companion_local_udp=18578")
    assert chosen.ground_ports == 8
    with pytest.raises(ScenarioError, match=r"ports\.gcs_local_udp of UAV 7 and .* 18577"):
        scenario(*RADIO, "ports.companion_local_udp=18577")
    # UAV 10 and 11 have no companion port where programs of ground stations receive
    many = scenario("agents=13", *RADIO[1:], "formation.columns=13", "formation.rows=1")
    assert [many.companion_port(i) for i in (9, 10, 11, 12)] == [14549, 0, 0, 14552]


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["links.telemetry=radio"], r'links\.telemetry: "radio" needs a ground station .*\[\[stations\]\]'),
        (
            [*RADIO, "autopilot.kind=px4", "autopilot.px4_build=build"],
            r'links\.telemetry: .*UAV 0 is flown by px4.*expected "wire"',
        ),
        ([*RADIO, "onboard.port=14550"], r"onboard\.port: 14550 is that of MAVLink"),
        ([*RADIO, "stations.1.name=uav-1"], r"stations\[1\]\.name: uav-1 is the name of a vehicle"),
        ([*RADIO, "stations.1.name=north"], r"stations\[1\]\.name: stations\[0\] is called north too"),
        (
            [*RADIO, "radio.guests=[{name='south', pos_ned_m=[0.0, 0.0, 0.0]}]"],
            r"stations\[1\]\.name: radio\.guests\[0\] is called south too",
        ),
        (
            [*RADIO, "stations.0.tx_power_dbm=1", "radio.stations=[{station=4}]"],
            r"radio\.stations\[0\]\.station: 4 is the ground station north",
        ),
        ([*RADIO, "stations.0.name='a b'"], r"stations\[0\]\.name: expected"),
        ([*RADIO, "stations.0.antenna=missing"], r"stations\[0\]\.antenna: no model 'missing'"),
    ],
)
def test_settings_that_contradict_each_other_are_one_line(overrides, line):
    with pytest.raises(ScenarioError, match=line) as error:
        scenario(*overrides)
    assert len(str(error.value).splitlines()) == 1

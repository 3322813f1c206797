"""Scenario files: an error is one line that names the file, the field and the reason."""

import msgspec
import numpy as np
import pytest
from paths import ROOT

from autopilot.onboard.formation_plan import FormationPlan
from autopilot.vehicle.vehicle import Vehicle
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load

ARTICLE = ROOT / "scenarios" / "article.toml"


def test_article_has_the_articles_settings():
    scenario = load(ARTICLE)
    assert scenario.agents == 8
    assert scenario.wind.mean_n == 5.0
    assert scenario.wind.gust_rms_fraction == 0.2
    assert scenario.wind.gust_time_constant_s == 2.0
    assert scenario.radio.bandwidth_mhz == 80
    assert scenario.radio.broadcast_rts
    assert scenario.onboard.beacon_period_ms == 100
    assert scenario.onboard.ftm_period_s == 1.0
    assert scenario.run.duration_s == 60.0
    places = scenario.places_ned_m()
    assert places.shape == (8, 3)
    # 0.85 lambda broadside is east, 0.25 lambda end-fire is north
    assert np.allclose(np.diff(np.unique(places[:, 1].round(9))), 8.5)
    assert np.allclose(np.diff(np.unique(places[:, 0].round(9))), 2.5)
    assert np.allclose(places[:, 2], -10.0)


@pytest.mark.parametrize("path", sorted((ROOT / "scenarios").glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_scenario_loads_and_is_unchanged_by_serialisation(path):
    scenario = load(path)
    assert msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario) == scenario


def test_heading_rotates_the_end_fire_axis_clockwise_from_north():
    east = load(ARTICLE, ["formation.heading_deg=90"]).places_ned_m()
    north = load(ARTICLE).places_ned_m()
    # north becomes east, east becomes south
    assert np.allclose(east[:, 1], north[:, 0])
    assert np.allclose(east[:, 0], -north[:, 1])


def test_fewer_agents_use_the_first_places_and_more_extend_the_grid():
    eight = load(ARTICLE).places_ned_m()
    assert np.array_equal(load(ARTICLE, ["agents=3"]).places_ned_m(), eight[:3])
    ten = load(ARTICLE, ["agents=10"]).places_ned_m()
    assert np.allclose(np.diff(ten, axis=0)[:7], np.diff(eight, axis=0))
    assert len(np.unique(ten[:, 0].round(9))) == 3


def _antenna_frame_m(scenario):
    """Return (x, y, z): right of the heading, along it, up."""
    heading_rad = np.radians(scenario.formation.heading_deg)
    north_m, east_m, down_m = scenario.places_ned_m().T
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.stack([east_m * c - north_m * s, north_m * c + east_m * s, -down_m], axis=1)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, -200.0])
@pytest.mark.parametrize("agents", [1, 2, 5])
def test_a_line_is_abreast(agents, heading_deg):
    shape = ["formation.shape=line", "formation.spacing_m=3.5", f"formation.heading_deg={heading_deg}"]
    places_m = _antenna_frame_m(load(ARTICLE, [*shape, f"agents={agents}"]))
    x_m = 3.5 * (np.arange(agents) - (agents - 1) / 2.0)
    np.testing.assert_allclose(places_m, np.stack([x_m, 0.0 * x_m, 10.0 + 0.0 * x_m], axis=1), atol=1e-12)


def test_a_ring_begins_ahead_and_continues_clockwise():
    shape = ["formation.shape=ring", "formation.radius_m=6.0", "formation.heading_deg=70"]
    places_m = _antenna_frame_m(load(ARTICLE, [*shape, "agents=6"]))
    np.testing.assert_allclose(np.linalg.norm(places_m[:, :2], axis=1), 6.0)
    gaps_m = np.linalg.norm(places_m - np.roll(places_m, 1, axis=0), axis=1)
    np.testing.assert_allclose(gaps_m, 6.0)  # a hexagon's side is its radius
    np.testing.assert_allclose(places_m[0], [0.0, 6.0, 10.0], atol=1e-12)
    assert places_m[1, 0] > 0.0


def test_a_vehicles_settings_have_the_motion_of_the_formation():
    scenario = load(ROOT / "scenarios" / "racetrack.toml", ["formation.heading_deg=40"])
    config = scenario.vehicle_config(2, run_id="test", radio_endpoint=None, log_path=None)
    assert config.motion == scenario.formation.motion
    assert config.heading_deg == 40.0
    own = FormationPlan(np.array(config.places_ned_m), config.heading_deg, config.motion).own(2, 50.0)
    np.testing.assert_allclose(own.pos_ned_m, scenario.plan().at(50.0).pos_ned_m[2])
    assert load(ARTICLE).vehicle_config(0, run_id="test", radio_endpoint=None, log_path=None).motion is None


def test_overrides_accept_numbers_strings_words_and_new_tables():
    scenario = load(
        ARTICLE,
        [
            "wind.mean_n=2",
            'sensors.profile="gazebo"',
            "onboard.localisation=gps",
            "autopilot.params.MPC_XY_P=1.1",
            "autopilot.per_uav.3.MPC_XY_P=1.2",
        ],
    )
    assert scenario.wind.mean_n == 2.0
    assert scenario.sensors.profile == "gazebo"
    assert scenario.onboard.localisation == "gps"
    assert scenario.autopilot.params["MPC_XY_P"] == 1.1
    assert scenario.autopilot.per_uav == {"3": {"MPC_XY_P": 1.2}}


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("wind.maen_n=2", "wind: unknown key `maen_n`"),
        ("wnd.mean_n=2", "unknown key `wnd`"),
        ("wind.mean_n=-1", "wind.mean_n: expected `float` >= 0.0"),
        ("wind.mean_n=strong", "wind.mean_n: expected `float`"),
        ("run.seed=-1", "run.seed: expected `int` >= 0"),
        ("onboard.loop_period_ms=18", "onboard.loop_period_ms: 18 ms is no whole number of steps"),
        ("onboard.loop_period_ms=0", "onboard.loop_period_ms: expected `int` >= 4"),
        ("radio.bandwidth_mhz=60", "radio.bandwidth_mhz: invalid enum value 60"),
        ("radio.ftm.ftms_per_burst=1", "radio.ftm.ftms_per_burst: expected `int` >= 2"),
        ("radio.control_mode=vht_mcs0", "radio.control_mode: RTS needs a non-HT mode, vht_mcs0 is VHT"),
        (
            'radio={bandwidth_mhz=20, ftm={mode="vht_mcs9"}}',
            "radio.ftm.mode: VHT MCS 9 does not exist on a 20 MHz channel",
        ),
        (
            "radio.ftm={burst_duration_us=250, min_delta_us=100}",
            # VHT MCS 0 on 80 MHz: 60 + 16 + 44 us with the parameters, AIFS 34, then 56 + 16 + 44
            (
                "radio.ftm.burst_duration_us: 250 us is too short for two measurement frames, "
                "which take 270 us with ftm.min_delta_us = 100"
            ),
        ),
        (
            "radio.ftm={burst_duration_us=500, min_delta_us=310}",
            # in units of 100 us that is 400, and 116 for the second frame
            "radio.ftm.burst_duration_us: 500 us is too short for two measurement frames, which take 516 us",
        ),
        (
            "radio={coverage_class=31, ftm={burst_duration_us=250, min_delta_us=100}}",
            # the slot is 9 + 31 * 3 us, so AIFS 16 + 2 * 102
            "radio.ftm.burst_duration_us: 250 us is too short for two measurement frames, which take 456 us",
        ),
        ("radio.coverage_class=32", "radio.coverage_class: expected `int` <= 31"),
        (
            "radio.frequency_mhz=2437",
            "radio.bandwidth_mhz: a channel at 2.4 GHz has 20 or 40 MHz, not 80",
        ),
        (
            "radio={frequency_mhz=2437, bandwidth_mhz=20}",
            "radio.ftm.mode: vht_mcs0 is VHT, which 2.4 GHz does not have; choose ofdm6 to ofdm54",
        ),
        (
            "radio.stations=[{station=8}]",
            "radio.stations[0].station: 8 is out of range for 8 stations",
        ),
        ("radio.extra_attenuation_db=1e6", "radio.extra_attenuation_db: expected `float` <= 1000.0"),
        (
            "radio.stations=[{station=1},{station=1}]",
            "radio.stations[1].station: duplicate entry of station 1",
        ),
        (
            'radio.guests=[{name="a", pos_ned_m=[0,0,0]}, {name="a", pos_ned_m=[0,9,0]}]',
            "radio.guests[1].name: duplicate name 'a'",
        ),
        (
            "radio.interferers=[{pos_ned_m=[0,0,0], duty_cycle=1.5}]",
            "radio.interferers[0].duty_cycle: expected",
        ),
        ("antenna.wavelength_m=0.5", "formation: places 0.12 m apart"),
        ("agents=0", "agents: expected `int` >= 1"),
        ("agents=255", "agents: expected `int` <= 254: MAVLink numbers systems 1 to 255, "),
        ("formation.shape=wedge", "formation.shape: invalid enum value 'wedge'"),
        ("formation.motion.speed_m_s=3", "formation.motion: object missing required field `kind`"),
        (
            "formation.motion.kind=circle",
            "formation.motion.kind: invalid value 'circle', expected one of track, racetrack",
        ),
        (
            'formation.motion={kind="track", radius_m=5.0}',
            "formation.motion: unknown key `radius_m`",
        ),
        (
            'formation.motion={kind="racetrack", speed_m_s=7.5}',
            "formation.motion.radius_m: UAV 0, 12.8 m off the centre, would reach 3.4 m/s^2 in a turn of",
        ),
        (
            'formation.motion={kind="track", length_m=inf}',
            "formation.motion.length_m: expected `float` <= 100000.0",
        ),
        (
            'formation.motion={kind="racetrack", length_m=1e308}',
            "formation.motion.length_m: expected `float` <= 100000.0",
        ),
        (
            'formation.motion={kind="track", speed_m_s=1e-200, acceleration_m_s2=1e-200, length_m=1e-200}',
            "formation.motion.speed_m_s: expected `float` >= 0.01",
        ),
        ("onboard.gps_bias_std_m=inf", "onboard.gps_bias_std_m: expected `float` <= 1000.0"),
        (
            "onboard.odometry_drift_m_sqrt_s=1e200",
            "onboard.odometry_drift_m_sqrt_s: expected `float` <= 10.0",
        ),
        ("ports.simulator_tcp=65530", "ports.simulator_tcp: 65530 + 7 vehicles is over 65535"),
        (
            "ports.companion_local_udp=18573",
            "ports.gcs_local_udp of UAV 3 and ports.companion_local_udp of UAV 0 are both 18573",
        ),
        (
            "ports.companion_local_udp=18567",
            "ports.gcs_local_udp of UAV 0 and ports.companion_local_udp of UAV 3 are both 18570",
        ),
        (
            "ports.gcs_remote_udp=18577",
            "ports.gcs_local_udp of UAV 7 and ports.gcs_remote_udp are both 18577",
        ),
        (
            "ports={radio_link='tcp', radio_tcp=4561}",
            "ports.simulator_tcp of UAV 1 and ports.radio_tcp are both 4561",
        ),
        ("links.host=localhost", "links: host: 'localhost' is not an IPv4 address"),
        ("links.companion_host=1.2.3", "links: companion_host: '1.2.3' is not an IPv4 address"),
        (
            "links.ground_station_host=192.168.1.7",
            "links: ground_station_host: other machines cannot be reached from 127.0.0.1",
        ),
        ("links.bandwidth_bytes_s=-1", "links.bandwidth_bytes_s: expected `int` >= 0"),
        ("links.signing_key_file=nowhere", "links.signing_key_file: "),
        ("wind.kind=breeze", "wind.kind: invalid enum value 'breeze'"),
        ("wind.mean_m_s=3", 'wind: mean_m_s: no effect where kind is "force"'),
        ('wind={kind="velocity", mean_n=2.0}', 'wind: mean_n: no effect where kind is "velocity"'),
        (
            "wind.kind=velocity",
            (
                'wind: mean_n, gust_rms_fraction, gust_time_constant_s: no effect where kind is "velocity"; '
                'correlation: no effect where turbulence is "none"'
            ),
        ),
        ("wind.mean_n=nan", "wind.mean_n: expected `float` >= 0.0"),
        ("run.duration_s=inf", "run.duration_s: expected `float` <= 1000000.0"),
        ("run.reach_timeout_s=inf", "run.reach_timeout_s: expected `float` <= 1000000.0"),
        ("run.record_rate_hz=1e-300", "run.record_rate_hz: expected `float` >= 0.001"),
        ("formation.endfire_spacing_lambda=inf", "formation.endfire_spacing_lambda: expected"),
        ("sensors.gps.white_std_m=inf", "sensors.gps.white_std_m: expected `float` <= 1000.0"),
        ("sensors.gps.rate_hz=1e-308", "sensors.gps.rate_hz: expected `float` >= 0.1"),
        ("sensors.gps.bias_time_constant_s=inf", "sensors.gps.bias_time_constant_s: expected"),
        ('wind.gusts=[{shape="step", start_s=1.0, peak_n=inf}]', "wind.gusts[0].peak_n: expected `float` <="),
        ('wind.gusts=[{shape="step", start_s=1.0, peak_m_s=3.0}]', "wind: gusts[0]: expected peak_n"),
        (
            'wind.gusts=[{shape="ramp", start_s=1.0, peak_n=3.0}]',
            'wind.gusts[0]: rise_s: a gust of shape "ramp" takes time to rise',
        ),
        ("environment.density=thin", "environment.density: invalid enum value 'thin'"),
        (
            'faults=[{kind="gps_los", uav=0}]',
            (
                "faults[0].kind: invalid value 'gps_los', expected one of gps_loss, gps_bias, gps_noise, "
                "accel_bias, gyro_bias, mag_bias, mag_yaw, baro_freeze, baro_bias, motor, motor_stop"
            ),
        ),
        ('faults=[{kind="gps_loss", uav=8}]', "faults[0].uav: 8 is none of 8 vehicles"),
        (
            'faults=[{kind="gps_loss", uav="some"}]',
            "faults[0].uav: invalid enum value 'some', expected a number or \"all\"",
        ),
        ('faults=[{kind="gps_loss", uav=[1]}]', 'faults[0].uav: expected a number or "all", got `array`'),
        ('faults=[{kind="gps_loss", uav=-1}]', "faults[0].uav: expected `int` >= 0"),
        (
            'faults=[{kind="gps_loss", uav=0, start_s=inf}]',
            "faults[0].start_s: expected `float` <= 1000000.0",
        ),
        ('faults=[{kind="gps_noise", uav=0}]', "faults[0]: position_std_m, velocity_std_m_s: expected one"),
        ("faults.0.uav=1", "--set faults.0.uav=1: faults has no entry 0; there are none"),
        ("wind.gusts.2.peak_n=1", "--set wind.gusts.2.peak_n=1: wind.gusts has no entry 2; there are none"),
        ('faults=[{kind="gps_loss", uav=0, start_s=-1.0}]', "faults[0].start_s: expected `float` >= 0.0"),
        (
            'faults=[{kind="motor", uav=0, motor=4, effectiveness=0.5}]',
            "faults[0].motor: 4 is none of the 4 motors of UAV 0 from 0 on",
        ),
        (
            'faults=[{kind="motor", uav=0, motor=0, effectiveness=1.5}]',
            "faults[0].effectiveness: expected `float` <= 1.0",
        ),
        ('faults=[{kind="accel_bias", uav=0}]', "faults[0]: object missing required field `offset_frd_m_s2`"),
        (
            "onboard.wind_feed_forward=true",
            "onboard.wind_feed_forward: the autopilot of UAV 0 already",
        ),
        ("wind", "--set wind: expected PATH=VALUE"),
        ("=3", "--set =3: expected PATH=VALUE"),
        ("agents.x=3", "--set agents.x=3: agents is a value, not a table"),
    ],
)
def test_a_wrong_field_is_named(override, message):
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [override])
    text = str(caught.value)
    assert message.lower() in text.lower()


def companion_ports(scenario):
    return [
        scenario.vehicle_config(i, run_id="x", radio_endpoint=None, log_path=None).ports.companion_remote_udp
        for i in range(scenario.agents)
    ]


def test_companions_have_ports_from_14540_on_except_ports_of_others():
    ports = companion_ports(load(ARTICLE, ["agents=64"]))
    # 14550 is the ground station's, and from 14580 on the swarm's own: UAV 40 would send to UAV 0
    assert ports == [14540 + i if i != 10 and i < 40 else 0 for i in range(64)]
    assert companion_ports(load(ARTICLE, ["agents=12", "ports.gcs_remote_udp=14000"]))[10] == 14550
    assert companion_ports(load(ARTICLE, ["agents=3", "ports.companion_remote_udp=0"])) == [0, 0, 0]


def test_on_other_machines_every_companion_port_is_free():
    there = ["links.host=0.0.0.0", "links.companion_host=10.0.0.9"]
    assert companion_ports(load(ARTICLE, ["agents=64", *there])) == [14540 + i for i in range(64)]
    both = [*there, "links.ground_station_host=10.0.0.9"]
    assert companion_ports(load(ARTICLE, ["agents=64", *both]))[9:12] == [14549, 0, 14551]


def test_links_are_local_by_default():
    vehicle = load(ARTICLE).vehicle_config(0, run_id="x", radio_endpoint=None, log_path=None)
    links = vehicle.links
    assert {links.host, links.ground_station_host, links.companion_host} == {"127.0.0.1"}
    assert (links.bandwidth_bytes_s, links.signing_key_file) == (0, None)


def test_a_signing_key_is_read_relative_to_the_scenario_and_not_copied(tmp_path):
    (tmp_path / "swarm.toml").write_text('[links]\nsigning_key_file = "key"\n')
    key = tmp_path / "key"
    with pytest.raises(ScenarioError, match=r"links\.signing_key_file: .*key: cannot be read"):
        load(tmp_path / "swarm.toml")
    key.write_bytes(b"")
    with pytest.raises(ScenarioError, match=r"links\.signing_key_file: .*key: neither a passphrase nor"):
        load(tmp_path / "swarm.toml")
    key.write_text("correct horse\n")
    scenario = load(tmp_path / "swarm.toml")
    assert scenario.links.signing_key_file == str(key)
    assert b"horse" not in msgspec.json.encode(scenario)


@pytest.mark.parametrize(
    "ftm",
    [
        "burst_duration_us=500, min_delta_us=300",  # 300 + 116 us
        "burst_duration_us=250, min_delta_us=100, mode='vht_mcs9'",  # 88 + 34 + 88 us
        "burst_duration_us=250, responder_min_delta_us=300",  # a responder that slow grants a longer burst
    ],
)
def test_a_burst_with_time_for_two_measurement_frames_is_accepted(ftm):
    assert load(ARTICLE, [f"radio.ftm={{{ftm}}}"]).radio.ftm.burst_duration_us <= 500


FAULTS = ROOT / "scenarios" / "faults.toml"
TURBULENCE = ROOT / "scenarios" / "turbulence.toml"


def test_overrides_address_entries_of_arrays_by_number():
    before, after = load(FAULTS), load(FAULTS, ["faults.0.uav=3", "faults.1.offset_ned_m.2=-4.0"])
    assert (before.faults[0].uav, after.faults[0].uav) == (0, 3)
    assert after.faults[1].offset_ned_m == (*before.faults[1].offset_ned_m[:2], -4.0)
    assert after.faults[2:] == before.faults[2:]
    assert load(TURBULENCE, ["wind.gusts.0.peak_m_s=3"]).wind.gusts[0].peak_m_s == 3.0
    whole = load(FAULTS, ['faults.3={kind="mag_yaw", uav="all", heading_error_deg=9.0}']).faults[3]
    assert whole.heading_error_deg == 9.0


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("faults.4.uav=1", "faults has no entry 4; there are numbers 0 to 3"),
        ("faults.-1.uav=1", "faults has no entry -1; there are numbers 0 to 3"),
        ("faults.first.uav=1", "faults has no entry first; there are numbers 0 to 3"),
        ("faults.0.uav.x=1", "faults.0.uav is a value, not a table"),
        ("faults.1.offset_ned_m.3=1.0", "faults.1.offset_ned_m has no entry 3; there are numbers 0 to 2"),
    ],
)
def test_a_missing_entry_is_an_error_in_one_line(override, message):
    with pytest.raises(ScenarioError) as caught:
        load(FAULTS, [override])
    assert str(caught.value) == f"--set {override}: {message}"


def test_a_vehicle_is_not_an_entry():
    """Tables with numeric keys remain tables."""
    scenario = load(ARTICLE, ["autopilot.per_uav.1.MPC_XY_P=1.1"])
    assert scenario.autopilot.per_uav == {"1": {"MPC_XY_P": 1.1}}


def test_a_missing_a_broken_and_a_binary_file_are_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"nowhere\.toml: there is no such file"):
        load(tmp_path / "nowhere.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("agents = = 3\n")
    with pytest.raises(ScenarioError, match=r"broken\.toml: not TOML"):
        load(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"broken\.toml: it is not text"):
        load(broken)


def test_a_vehicles_settings_have_the_properties_of_its_devices():
    overrides = ["sensors.gps.delay_s=0.2", "radio.bandwidth_mhz=40"]
    config = load(ARTICLE, overrides).vehicle_config(0, run_id="test", radio_endpoint=None, log_path=None)
    assert config.devices.gps_delay_s == 0.2
    assert config.devices.ftm_trip_std_m == pytest.approx(0.161, abs=0.001)  # 1075 ps, c/2
    assert Vehicle(config).parameters.get("EKF2_GPS_DELAY") == pytest.approx(200.0)


def test_ranging_sessions_may_not_last_longer_than_odometry_is_stored():
    """Four bursts 0.5 s apart end 1.5 s after the first, eight 3.5 s."""
    period = "radio.ftm.burst_period_ms=500"
    load(ARTICLE, [period, "radio.ftm.bursts_exponent=2"])
    with pytest.raises(
        ScenarioError, match=r"radio\.ftm\.bursts_exponent: sessions of 3\.5 s.*at most 1\.5 s"
    ):
        load(ARTICLE, [period, "radio.ftm.bursts_exponent=3"])
    load(ARTICLE, [period, "radio.ftm.bursts_exponent=3", "onboard.localisation=gps"])


@pytest.mark.parametrize(
    ("override", "where"),
    [
        ("antenna.wavelength_m=inf", "antenna.wavelength_m"),
        ("antenna.wavelength_m=9000", "formation"),
        ("antenna.snapshot_rate_hz=inf", "antenna.snapshot_rate_hz"),
        ("antenna.element_length_m=nan", "antenna.element_length_m"),
    ],
)
def test_every_length_has_a_limit(override, where):
    with pytest.raises(ScenarioError, match=where):
        load(ARTICLE, [override])


def test_vehicles_settings_have_the_date_of_time_0():
    def told_us(*overrides):
        vehicle = load(ARTICLE, overrides).vehicle_config(0, run_id="x", radio_endpoint=None, log_path=None)
        return vehicle.epoch_unix_us

    assert told_us("run.epoch_utc=1970-01-01T00:00:01.5Z") == 1_500_000
    assert told_us("run.epoch_utc=1970-01-01T02:00:00+02:00") == 0
    assert (
        told_us()
        == told_us("run.epoch_utc=2026-01-01T00:00:00Z")
        > told_us("run.epoch_utc=2025-12-31T23:59:59Z")
    )
    for wrong, message in [
        ("1969-12-31T23:59:59Z", "run: epoch_utc is before 1970"),
        ("2500-01-01T00:00:00Z", "run: epoch_utc is in 2500 or later"),
        ("2026-01-01T00:00:00", "run.epoch_utc: expected `datetime` with a timezone"),
        ("yesterday", "run.epoch_utc: invalid RFC3339"),
    ]:
        with pytest.raises(ScenarioError, match=message):
            load(ARTICLE, [f"run.epoch_utc={wrong}"])

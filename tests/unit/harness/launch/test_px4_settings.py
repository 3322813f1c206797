"""Settings of PX4s in a scenario, the command that starts one, and the messages of the simulator to it."""

import json
import lzma
import math
import os
import re

import numpy as np
import pytest
from msgspec.structs import replace
from world_truth import truth_with

from autopilot.estimation.atmosphere import pressure_pa
from autopilot.mavlink.codec import Parser
from autopilot.parameters.config import RadioEndpoint, VehicleConfig
from foundation.airframe.files import IRIS
from harness.launch import external_autopilots, px4
from harness.launch.external_process import AutopilotError
from harness.launch.px4_parameters import PARAMETER_LIST, known_parameters
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from harness.simulator.hil import RC_PERIOD_US, SensorEncoder
from harness.world import esc
from harness.world.sensors.config import PROFILES, SensorsConfig
from harness.world.sensors.suite import SensorSuite

STEP_US = 4_000
EPOCH_US = 1_767_225_600_000_000


PX4S_LIST = {
    "version": 1,
    "parameters": [
        {"name": name, "min": low, "max": high, "type": "Int32"}
        for name, low, high in (
            ("EKF2_HGT_REF", 0, 3), ("EKF2_GPS_CTRL", 0, 15), ("EKF2_GPS_DELAY", 0, 300),
            ("EKF2_REQ_HDRIFT", 0.1, 1.0), ("EKF2_REQ_VDRIFT", 0.1, 1.5), ("MPC_XY_P", 0, 2),
        )
    ],
}  # fmt: skip
"""As PX4's list of a version without SENS_BAR_AUTOCAL; entries have further fields."""
SUITED = {"EKF2_HGT_REF": "0", "EKF2_GPS_CTRL": "5", "SENS_BAR_AUTOCAL": "0"}


@pytest.fixture(autouse=True)
def user(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)


@pytest.fixture
def build(tmp_path):
    (tmp_path / "build" / "bin").mkdir(parents=True)
    (tmp_path / "build" / "bin" / "px4").touch()
    return tmp_path / "build"


@pytest.fixture
def scenario(tmp_path, build):
    path = tmp_path / "some.toml"
    path.write_text("agents = 3\n", encoding="ascii")

    def make(*overrides):
        return load(path, ["autopilot.kind=px4", f"autopilot.px4_build='{build}'", *overrides])

    return make


def test_px4_without_a_build_is_an_error_in_one_line(tmp_path):
    path = tmp_path / "some.toml"
    path.write_text("agents = 3\n", encoding="ascii")
    with pytest.raises(ScenarioError, match=r"^[^\n]*autopilot\.px4_build: missing[^\n]*$"):
        load(path, ["autopilot.kind=px4"])


def test_a_build_without_its_program_is_refused_before_anything_starts(scenario, build):
    (build / "bin" / "px4").unlink()
    missing = r"^autopilot\.px4_build: there is no .*/bin/px4; expected[^\n]*$"
    with pytest.raises(AutopilotError, match=missing):
        px4.check_start(scenario())


def test_own_vehicles_need_no_px4_settings(tmp_path):
    path = tmp_path / "some.toml"
    path.write_text("agents = 3\n", encoding="ascii")
    assert px4.instances(load(path)) == ()
    px4.check_start(load(path, ["ports.simulator_tcp=0"]))


@pytest.mark.parametrize(
    ("override", "error"),
    [
        ("autopilot.px4_command=['{build}/px4', '{instance}']", r"px4_command: \{instance\} stands for noth"),
        ("autopilot.px4_env.X='{'", r"px4_env\.X"),
        ("autopilot.px4_command=[]", "px4_command"),
        ("autopilot.px4_vehicles=[0, 3]", "px4_vehicles: there is no UAV 3 among 3"),
        ("autopilot.params.lower_case=1", "autopilot.params: 'lower_case' is no parameter's name"),
        ("autopilot.per_uav.3.MIS_TAKEOFF_ALT=1", "autopilot.per_uav: there is no UAV '3'"),
        ("autopilot.fence=[{shape='circle', radius_m=50}]", "autopilot.fence: a PX4 takes its plans"),
        (
            "autopilot.controller='a:B'",
            "autopilot.controller: a PX4 has its own controller, ",
        ),
        ("autopilot.modes=['a:B']", "autopilot.modes: a PX4 has its own controller, "),
        (
            "autopilot.services=['a:B']",
            "autopilot.services: a PX4 has its own controller, ",
        ),
    ],
)
def test_invalid_px4_settings_are_refused_with_the_fields_path(scenario, override, error):
    with pytest.raises(ScenarioError, match=error):
        scenario(override)


def test_px4_accepts_parameters_that_the_own_autopilot_does_not_have(scenario, tmp_path):
    swarm = scenario("autopilot.params.EKF2_IMU_POS_X=0.1", "autopilot.px4_vehicles=[0, 1, 2]")
    config = px4.process_config(swarm, 0, run_folder=tmp_path, simulator_port=4560)
    assert config.environment["PX4_PARAM_EKF2_IMU_POS_X"] == "0.1"
    with pytest.raises(ScenarioError, match="EKF2_IMU_POS_X"):  # because of vehicle 2, which is no PX4
        scenario("autopilot.params.EKF2_IMU_POS_X=0.1", "autopilot.px4_vehicles=[0, 1]")


def test_the_default_command_starts_a_px4_sitl_instance(scenario, build, tmp_path):
    swarm = scenario()
    for i in px4.instances(swarm):
        config = px4.process_config(swarm, i, run_folder=tmp_path, simulator_port=4560 + i)
        assert config.command == (
            f"{build}/bin/px4", "-i", str(i), "-d", f"{build}/etc", "-w", config.folder,
        )  # fmt: skip
        assert config.environment["PX4_SIM_MODEL"] == "none_iris"
        assert config.name == f"uav {i}"
        assert config.details == {"gcs_local_udp": 18570 + i, "companion_local_udp": 14580 + i}
        assert config.folder.startswith(str(tmp_path))


def test_the_command_can_be_wrapped(scenario, build, tmp_path):
    swarm = scenario(
        "autopilot.px4_command=['nice', '{build}/bin/px4', '-i', '{i}', '{sysid}:{tcp}:{host}']",
        "autopilot.px4_env={PX4_SIM_MODEL='iris', PORTS='{companion_local}>{companion_remote}'}",
    )
    config = px4.process_config(swarm, 2, run_folder=tmp_path, simulator_port=4999)
    assert config.command == ("nice", f"{build}/bin/px4", "-i", "2", "3:4999:127.0.0.1")
    assert config.environment["PORTS"] == "14582>14542"
    assert config.environment["PX4_SIM_MODEL"] == "iris"


def test_parameters_are_passed_except_own_ones_and_whole_ones_as_integers(scenario, tmp_path):
    swarm = scenario(
        "autopilot.params={CF_DOB_EN=1, COM_RC_IN_MODE=4, MPC_XY_P=0.8}",
        "autopilot.per_uav.1={MPC_XY_P=0.9, EKF2_GPS_DELAY=50}",
        "sensors.gps.delay_s=0.2",
    )
    passed = [
        {
            name.removeprefix("PX4_PARAM_"): value
            for name, value in px4.process_config(
                swarm, i, run_folder=tmp_path, simulator_port=4560
            ).environment.items()
            if name.startswith("PX4_PARAM_") and "DRIFT" not in name
        }
        for i in (0, 1)
    ]
    assert passed[0] == SUITED | {"EKF2_GPS_DELAY": "200", "COM_RC_IN_MODE": "4", "MPC_XY_P": "0.8"}
    assert passed[1] == SUITED | {"EKF2_GPS_DELAY": "50", "COM_RC_IN_MODE": "4", "MPC_XY_P": "0.9"}


def passed_parameters(swarm, tmp_path, i=0):
    environment = px4.process_config(swarm, i, run_folder=tmp_path, simulator_port=4560).environment
    prefix = "PX4_PARAM_"
    return {name.removeprefix(prefix): v for name, v in environment.items() if name.startswith(prefix)}


def test_the_default_parameters_can_be_taken_back_one_by_one_or_all(scenario, tmp_path):
    one = passed_parameters(scenario("autopilot.params={EKF2_HGT_REF=1}"), tmp_path / "one")
    assert {name: one[name] for name in SUITED} == SUITED | {"EKF2_HGT_REF": "1"}
    none = passed_parameters(scenario("autopilot.px4_simulation_parameters=false"), tmp_path / "none")
    assert not SUITED.keys() & none.keys()


def write_list(build):
    (build / "etc" / "extras").mkdir(parents=True)
    with lzma.open(build / PARAMETER_LIST, "wb") as file:
        file.write(json.dumps(PX4S_LIST).encode())


def test_default_parameters_that_a_version_does_not_have_are_left_out(scenario, build, tmp_path):
    write_list(build)
    assert passed_parameters(scenario(), tmp_path).keys() == {
        parameter["name"] for parameter in PX4S_LIST["parameters"]
    } - {"MPC_XY_P"}


@pytest.mark.parametrize(
    ("override", "error"),
    [
        (
            "autopilot.params={EKF2_HGTREF=0}",
            "EKF2_HGTREF: this PX4 has no such parameter; EKF2_HGT_REF exists",
        ),
        ("autopilot.params={EKF2_HGT_REF=4}", "EKF2_HGT_REF: 4 is out of its range, 0 to 3"),
        ("autopilot.per_uav.1={MPC_XY_P=-1}", "MPC_XY_P: -1 is out of its range, 0 to 2"),
    ],
)
def test_wrong_parameters_are_refused_by_px4s_own_list(scenario, build, override, error):
    px4.check_start(scenario(override))  # without a list PX4 itself has the last word
    write_list(build)
    with pytest.raises(AutopilotError, match=re.escape(f"autopilot.params: {error}")):
        px4.check_start(scenario(override))
    px4.check_start(scenario("autopilot.params={CF_DOB_EN=1, MPC_XY_P=1.0}"))


@pytest.mark.parametrize("content", [b"", b"no list", lzma.compress(b"{}"), lzma.compress(b"[")])
def test_an_unreadable_list_is_none(build, content):
    (build / "etc" / "extras").mkdir(parents=True)
    (build / PARAMETER_LIST).write_bytes(content)
    assert known_parameters(build) is None


def test_root_is_refused_unless_the_command_changes_the_user(scenario, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    with pytest.raises(AutopilotError, match=r"^autopilot\.kind: PX4 is not to run as root[^\n]*setpriv$"):
        px4.check_start(scenario())
    px4.check_start(scenario("autopilot.px4_command=['setpriv', '--reuid=1000', '{build}/bin/px4']"))


def test_a_swarm_on_other_ports_has_other_instances_and_the_same_systems(scenario, tmp_path):
    ports = {"simulator_tcp": 5560, "gcs_local_udp": 19570, "companion_local_udp": 15580}
    raised = scenario(*(f"ports.{field}={port}" for field, port in ports.items()))
    px4.check_start(raised)
    config = px4.process_config(raised, 2, run_folder=tmp_path, simulator_port=5562)
    assert config.command[1:3] == ("-i", "1002")
    assert config.environment["PX4_PARAM_MAV_SYS_ID"] == "3"
    assert "PX4_PARAM_MAV_SYS_ID" not in passed_parameters(scenario(), tmp_path / "unraised")


def drift_rms_m_s(model, std_m, rng):
    """Return the RMS of PX4's drift, filtered over 10 s, of a simulated Gauss-Markov error."""
    interval_s, filter_s = 1.0 / model.rate_hz, 10.0
    keep = math.exp(-interval_s / model.bias_time_constant_s)
    error_m, mean_m_s, squares = std_m * rng.standard_normal(1000), np.zeros(1000), []
    for k in range(600):
        before_m = error_m
        error_m = keep * error_m + math.sqrt(1 - keep**2) * std_m * rng.standard_normal(1000)
        mean_m_s += interval_s / filter_s * ((error_m - before_m) / interval_s - mean_m_s)
        if k > 300:
            squares.append(np.mean(mean_m_s**2))
    return math.sqrt(np.mean(squares))


def test_the_drift_limits_are_raised_for_a_receiver_that_drifts_more(scenario, tmp_path):
    model = PROFILES["consumer"].gps
    rng = np.random.default_rng(3)
    environment = px4.process_config(scenario(), 0, run_folder=tmp_path, simulator_port=4560).environment
    for axis, std_m in (("H", model.horizontal_bias_std_m), ("V", model.vertical_bias_std_m)):
        limit_m_s = float(environment[f"PX4_PARAM_EKF2_REQ_{axis}DRIFT"])
        assert limit_m_s == pytest.approx(5 * drift_rms_m_s(model, std_m, rng), rel=0.1)
    still = px4.process_config(
        scenario("sensors.profile=gazebo"), 1, run_folder=tmp_path, simulator_port=4560
    ).environment
    assert not any("DRIFT" in name for name in still)


@pytest.mark.parametrize("field", ["simulator_tcp", "gcs_local_udp", "companion_local_udp"])
def test_ports_that_px4_does_not_use_are_refused_unless_the_command_passes_them(scenario, field):
    placeholder = {"simulator_tcp": "tcp"}.get(field, field.removesuffix("_udp"))
    passed = f"autopilot.px4_command=['{{build}}/bin/px4', '{{{placeholder}}}']"
    px4.check_start(scenario())
    for base in (0, 21_000):
        with pytest.raises(AutopilotError, match=rf"^ports\.{field}: a PX4 listens on [^\n]*$"):
            px4.check_start(scenario(f"ports.{field}={base}"))
    px4.check_start(scenario(f"ports.{field}=21000", passed))


def test_the_truth_cannot_be_sent_to_an_application_beside_a_px4(scenario):
    with pytest.raises(AutopilotError, match=r"onboard\.localisation"):
        px4.check_start(scenario("onboard.localisation=truth"))


def test_applications_bind_the_ports_that_px4s_send_to(scenario):
    assert external_autopilots.application_ports(scenario()) == [14540, 14541, 14542]
    assert external_autopilots.application_ports(scenario("autopilot.px4_vehicles=[1]")) == [14541]
    assert external_autopilots.application_ports(scenario("onboard.enabled=false")) == []


def test_the_vehicles_settings_are_read_by_its_application_process(scenario):
    endpoint = RadioEndpoint(locator="tcp/127.0.0.1:7447", password="")
    config = scenario().vehicle_config(1, run_id="x", radio_endpoint=endpoint, log_path=None)
    assert isinstance(config, VehicleConfig)
    assert (config.ports.companion_local_udp, config.ports.companion_remote_udp) == (14581, 14541)


# ---- messages of the simulator to a PX4


def second_of_sensors(encoder, vehicles, steps=250, *, escs=False):
    """Return the messages to each vehicle at rest in one second, by step."""
    still = np.zeros((vehicles, 3))
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (vehicles, 1))
    truth = truth_with(
        pos_ned_m=still, vel_ned_m_s=still, q_ned_frd=upright, omega_frd_rad_s=still,
        mean_omega_frd_rad_s=still, specific_force_frd_m_s2=np.tile([0.0, 0.0, -9.8066], (vehicles, 1)),
        rotor_speed_rad_s=np.zeros((vehicles, 4)), acc_ned_m_s2=still,
    )  # fmt: skip
    suite = SensorSuite(
        config=SensorsConfig(), site=encoder._site, vehicles=vehicles, step_us=STEP_US,
        seed=np.random.SeedSequence(1),
    )  # fmt: skip
    parsers = [Parser() for _ in range(vehicles)]
    received = [[] for _ in range(vehicles)]
    controllers = esc.SpeedControllers([IRIS] * vehicles)
    for k in range(1, steps + 1):
        frame = suite.sample(k * STEP_US, truth)
        due = escs and k % 25 == 0
        motors = controllers.statuses(k * STEP_US, truth.rotor_speed_rad_s) if due else ()
        for i, data in enumerate(encoder.encode(k * STEP_US, frame, motors)):
            received[i].append(parsers[i].push(data))
    assert all(parser.bad_bytes == 0 for parser in parsers)
    return received


def test_a_px4_receives_whole_groups_of_fields_with_utc_and_no_esc_status():
    (steps,) = second_of_sensors(SensorEncoder(px4=(0,), epoch_us=EPOCH_US), 1)
    sensors = [messages[-1] for messages in steps]
    assert [sensor.get_type() for sensor in sensors] == ["HIL_SENSOR"] * 250
    assert [sensor.time_usec for sensor in sensors] == [k * STEP_US for k in range(1, 251)]
    assert {sensor.id for sensor in sensors} == {0}
    groups = {"accel": 0b111, "gyro": 0b111000, "mag": 0b111000000, "baro": 0x1A00}
    counts = dict.fromkeys(groups, 0)
    for sensor in sensors:
        fields = sensor.fields_updated
        for name, bits in groups.items():
            assert fields & bits in {0, bits}
            counts[name] += fields & bits == bits
        assert fields & ~sum(groups.values()) == 0
    assert counts == {"accel": 250, "gyro": 250, "mag": 50, "baro": 50}
    with_baro = next(sensor for sensor in sensors if sensor.fields_updated & 0x1A00)
    assert with_baro.abs_pressure == pytest.approx(float(pressure_pa(488.0)) / 100, abs=1.0)
    others = [message for messages in steps for message in messages[:-1]]
    assert {message.get_type() for message in others} == {"HIL_GPS"}
    assert len(others) in {4, 5}  # 5 Hz; the first after the delay of a fix
    for messages in steps:
        for fix in messages[:-1]:
            assert fix.time_usec == EPOCH_US + messages[-1].time_usec
            assert (fix.fix_type, fix.satellites_visible) == (3, 10)


def test_rc_channels_are_sent_ten_times_a_second_if_enabled():
    (steps,) = second_of_sensors(SensorEncoder(px4=(0,), px4_rc=True), 1)
    times_us = [
        messages[-1].time_usec for messages in steps for m in messages if m.get_type() == "RC_CHANNELS"
    ]
    assert times_us == list(range(RC_PERIOD_US, 1_000_001, RC_PERIOD_US))
    sticks = next(m for messages in steps for m in messages if m.get_type() == "RC_CHANNELS")
    assert [getattr(sticks, f"chan{k}_raw") for k in (1, 2, 3, 4, 5)] == [1500] * 4 + [65535]
    sequence = [m.get_seq() for messages in steps for m in messages]
    assert sequence == [k % 256 for k in range(len(sequence))]  # no gaps


def test_in_a_mixed_swarm_own_vehicles_get_the_same_bytes_as_without_px4s():
    alone = second_of_sensors(SensorEncoder(), 2, escs=True)
    mixed = second_of_sensors(SensorEncoder(px4=(1,), epoch_us=EPOCH_US), 2, escs=True)
    raw = [[m.get_msgbuf() for messages in vehicles[0] for m in messages] for vehicles in (alone, mixed)]
    assert raw[0] == raw[1]
    kinds = [[m.get_type() for messages in steps for m in messages] for steps in mixed]
    assert "ESC_STATUS" in kinds[0]
    assert kinds[1] == [kind for kind in kinds[0] if kind != "ESC_STATUS"]


def test_px4_vehicles_are_those_of_the_settings(scenario):
    autopilot = scenario("autopilot.px4_vehicles=[1]").autopilot
    assert [autopilot.is_px4(i) for i in range(3)] == [False, True, False]
    assert not replace(autopilot, kind="own").is_px4(1)

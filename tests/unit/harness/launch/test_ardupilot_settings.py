"""Settings of ArduPilots in a scenario, the command and parameters of one, and its thrust curve."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from foundation.airframe.files import IRIS
from harness.launch import ardupilot, external_autopilots, px4
from harness.launch.external_process import AutopilotError
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from harness.world.physics.rotors import kernel_model, rotor_speeds

EXAMPLE = "agents = 3\n[formation]\nheading_deg = -90.0\n"


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "arducopter"
    path.touch(mode=0o755)
    return path


@pytest.fixture
def scenario(tmp_path, program):
    path = tmp_path / "some.toml"
    path.write_text(EXAMPLE, encoding="ascii")

    def make(*overrides):
        given = ["autopilot.kind=ardupilot", f"autopilot.ardupilot_program='{program}'", *overrides]
        return load(path, given)

    return make


def written(path):
    """Return the parameters in a file of them."""
    rows = [line.split() for line in path.read_text("ascii").splitlines()]
    assert len({name for name, _ in rows}) == len(rows)
    return {name: float(value) for name, value in rows}


# ---- scenario


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["autopilot.ardupilot_vehicles=[3]"], "autopilot.ardupilot_vehicles: there is no UAV 3 among 3"),
        (["autopilot.params.wp_spd=1"], "autopilot.params: 'wp_spd' is no parameter's name"),
        (["autopilot.params.A2345678901234567=1"], "autopilot.params: 'A2345678901234567' is no parameter's"),
        (["autopilot.per_uav.1.X-Y=1"], "autopilot.per_uav.1: 'X-Y' is no parameter's name"),
        (["autopilot.per_uav.3.WP_SPD=1"], "autopilot.per_uav: there is no UAV '3' among 3"),
        (
            ["autopilot.ardupilot_command=['{tcp}']"],
            "autopilot.ardupilot_command: {tcp} stands for nothing",
        ),
        (["autopilot.ardupilot_command=['{']"], "autopilot.ardupilot_command: '{': "),
        (["autopilot.ardupilot_command=[]"], "autopilot.ardupilot_command: "),
        (
            ["autopilot.fence=[{shape='circle', radius_m=9.0}]"],
            "autopilot.fence: an ArduPilot takes its plans from a ground station only",
        ),
        (["onboard.wind_feed_forward=true"], "onboard.wind_feed_forward: ArduPilot takes accelerations as "),
    ],
)
def test_a_wrong_setting_is_an_error_in_one_line(scenario, overrides, line):
    with pytest.raises(ScenarioError, match=rf"^[^\n]*{re.escape(line)}[^\n]*$"):
        scenario(*overrides)


def test_a_missing_program_is_an_error_in_one_line(tmp_path):
    path = tmp_path / "some.toml"
    path.write_text(EXAMPLE, encoding="ascii")
    with pytest.raises(ScenarioError, match=r"^[^\n]*autopilot\.ardupilot_program: missing; expected[^\n]*$"):
        load(path, ["autopilot.kind=ardupilot"])


def test_own_vehicles_beside_have_the_parameters_of_coflights_autopilot(scenario):
    mixed = ["autopilot.ardupilot_vehicles=[1]", "autopilot.per_uav.1.WP_SPD=5"]
    assert scenario(*mixed).autopilot.external_params(1) == {"WP_SPD": 5.0}
    with pytest.raises(ScenarioError, match=r"autopilot\.per_uav\.0: "):
        scenario(*mixed, "autopilot.per_uav.0.WP_SPD=5")


def test_each_vehicle_has_its_kind(scenario):
    mixed = scenario("autopilot.ardupilot_vehicles=[1]")
    assert [mixed.autopilot.kind_of(i) for i in range(3)] == ["own", "ardupilot", "own"]
    assert not any(mixed.autopilot.is_px4(i) for i in range(3))
    assert mixed.ardupilots == external_autopilots.instances(mixed) == (1,)
    assert px4.instances(mixed) == ()
    assert external_autopilots.TITLES["ardupilot"] == "an ArduPilot"
    # lists of another kind of autopilot choose nothing
    assert scenario("autopilot.px4_vehicles=[1]").ardupilots == (0, 1, 2)


@pytest.mark.parametrize("uav", [1, '"all"'])
@pytest.mark.parametrize("fault", ["mag_bias", "mag_yaw"])
def test_faults_of_a_compass_that_the_autopilot_simulates_are_refused(scenario, fault, uav):
    size = "offset_frd_gauss=[0.1,0.0,0.0]" if fault == "mag_bias" else "heading_error_deg=20.0"
    faults = f'faults=[{{kind="{fault}",uav={uav},start_s=1.0,{size}}}]'
    with pytest.raises(ScenarioError, match=rf"faults\[0\]\.kind: {fault} cannot act on UAV 1, as an Ardu"):
        scenario("autopilot.ardupilot_vehicles=[1]", faults)
    scenario("autopilot.ardupilot_vehicles=[2]", faults.replace('"all"', "0"))


# ---- start


@pytest.mark.parametrize("spoil", ["absent", "not_executable", "folder"])
def test_a_program_that_cannot_be_executed_is_refused(scenario, program, spoil):
    external_autopilots.check_start(scenario())
    program.chmod(0o644)
    if spoil != "not_executable":
        program.unlink()
    if spoil == "folder":
        program.mkdir()
    with pytest.raises(
        AutopilotError, match=rf"^autopilot\.ardupilot_program: there is no program {program}"
    ):
        external_autopilots.check_start(scenario())


def test_the_truth_cannot_be_sent_to_an_application_beside_an_ardupilot(scenario):
    with pytest.raises(AutopilotError, match=r"^onboard\.localisation: [^\n]*$"):
        ardupilot.check_start(scenario("onboard.localisation=truth"))
    ardupilot.check_start(scenario("onboard.localisation=truth", "onboard.enabled=false"))


@pytest.mark.parametrize("path", ["params", "per_uav.1"])
def test_pulses_that_the_simulator_does_not_read_are_refused(scenario, path):
    ardupilot.check_start(scenario(f"autopilot.{path}.MOT_PWM_MAX=2000"))
    with pytest.raises(AutopilotError, match=r"^autopilot\.params\.MOT_PWM_MAX: expected 2000[^\n]*$"):
        ardupilot.check_start(scenario(f"autopilot.{path}.MOT_PWM_MAX=1900"))


def test_an_application_without_a_port_is_named(scenario):
    """The eleventh vehicle's port is that of ground stations, 14550."""
    many = scenario("agents=11")
    with pytest.raises(
        AutopilotError, match=r"^ports\.companion_remote_udp: the application of UAV 10[^\n]*$"
    ):
        ardupilot.check_start(many)
    ardupilot.check_start(scenario("agents=11", "ports.companion_remote_udp=30000"))
    ardupilot.check_start(scenario("agents=11", "onboard.enabled=false"))
    with pytest.raises(AutopilotError, match=r"UAV 0"):
        ardupilot.check_start(scenario("ports.companion_remote_udp=0"))


def test_applications_bind_the_ports_that_ardupilots_send_to(scenario):
    assert external_autopilots.application_ports(scenario()) == [14540, 14541, 14542]
    assert external_autopilots.application_ports(scenario("autopilot.ardupilot_vehicles=[2]")) == [14542]
    assert external_autopilots.application_ports(scenario("onboard.enabled=false")) == []


def test_the_command_has_the_vehicles_numbers_and_ports(scenario, tmp_path, program):
    given = scenario("site.latitude_deg=1.5", "site.longitude_deg=-2.25", "site.altitude_m=300")
    config = external_autopilots.process_config(given, 2, run_folder=tmp_path, simulator_port=4_711)
    options = dict(zip(config.command[1::2], config.command[2::2], strict=True))
    assert config.name == "uav 2"
    assert config.command[0] == str(program)
    assert options["--model"] == "JSON:127.0.0.1"
    assert (options["-I"], options["--sysid"], options["--sim-port-out"]) == ("2", "3", "4711")
    assert [float(each) for each in options["--home"].split(",")] == [1.5, -2.25, 300.0, 270.0]
    assert options["--serial0"] == "udpclient:127.0.0.1:14550"
    assert options["--serial1"] == "udpclient:127.0.0.1:14542"
    assert options["--serial2"] == "tcpclient:127.0.0.1:4711"
    assert config.folder == str(tmp_path / "ardupilot" / "uav-2")
    assert options["--defaults"] == f"{config.folder}/coflight.parm"


def test_parameters_of_the_scenario_have_precedence_and_own_ones_are_left_out(scenario, tmp_path):
    given = scenario(
        "autopilot.params.BATT_CAPACITY=1234.5",
        "autopilot.params.WP_SPD=0.1",
        "autopilot.per_uav.1.WP_SPD=7",
        "sensors.profile=ideal",
    )
    values = {}
    for i in range(2):
        config = ardupilot.process_config(given, i, run_folder=tmp_path, simulator_port=1)
        values[i] = written(tmp_path / "ardupilot" / f"uav-{i}" / "coflight.parm")
        assert str(tmp_path / "ardupilot" / f"uav-{i}" / "coflight.parm") in config.command
    assert (values[0]["WP_SPD"], values[1]["WP_SPD"]) == (0.1, 7.0)
    assert values[0]["BATT_CAPACITY"] == 1234.5
    assert values[0].keys() == ardupilot.parameters(given).keys() | {"WP_SPD"}
    assert values[0]["GPS1_DELAY_MS"] == given.sensors.gps_model().delay_s * 1e3
    assert values[0]["SIM_MAG_RND"] == 0.0


@pytest.mark.parametrize(("step_us", "rate_hz"), [(1_000, 400), (2_000, 250), (4_000, 125), (20_000, 50)])
def test_the_loop_runs_at_every_other_step_within_ardupilots_range(scenario, step_us, rate_hz):
    given = scenario()
    given = replace(given, run=replace(given.run, step_us=step_us))
    assert ardupilot.parameters(given)["SCHED_LOOP_RATE"] == rate_hz


# ---- thrust curve


def static_thrusts_n(controls):
    """Return the thrust of a rotor after a long time at each control, without motion, at sea level."""
    model, armed, stopped = kernel_model([IRIS], step_s=10.0), np.ones(1, bool), np.zeros((1, 4), bool)
    thrusts_n = []
    for control in controls:
        speeds = rotor_speeds(model, np.zeros((1, 4)), np.full((1, 4), control), armed, stopped)
        thrusts_n.append(model.thrust_n_s2[0] * speeds[0, 0] ** 2)
    return np.array(thrusts_n)


def test_the_thrust_curve_is_that_of_the_physics():
    """Against a least-squares fit of ArduPilot's curve to the physics' thrusts."""
    curve = ardupilot.thrust_curve(IRIS)
    ratios = np.linspace(0.0, 1.0, 101)
    controls = curve["MOT_SPIN_MIN"] + ratios * (curve["MOT_SPIN_MAX"] - curve["MOT_SPIN_MIN"])
    thrusts_n = static_thrusts_n(controls)
    shares = (thrusts_n - thrusts_n[0]) / (thrusts_n[-1] - thrusts_n[0])
    # shares - r = e (r^2 - r)
    basis = ratios**2 - ratios
    fitted = float(basis @ (shares - ratios) / (basis @ basis))
    assert curve["MOT_THST_EXPO"] == pytest.approx(fitted, abs=1e-3)
    expo = curve["MOT_THST_EXPO"]
    assert np.abs((1.0 - expo) * ratios + expo * ratios**2 - shares).max() < 1e-3


def test_the_hover_throttle_carries_the_vehicle():
    curve = ardupilot.thrust_curve(IRIS)
    least_n, most_n = static_thrusts_n([curve["MOT_SPIN_MIN"], curve["MOT_SPIN_MAX"]])
    hover_n = least_n + curve["MOT_THST_HOVER"] * (most_n - least_n)
    assert 4.0 * hover_n == pytest.approx(IRIS.mass_kg * 9.80665, rel=1e-3)
    assert 0.125 <= curve["MOT_THST_HOVER"] <= 0.6875  # ArduPilot's range

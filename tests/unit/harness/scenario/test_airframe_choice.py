"""Airframes named by a scenario: packaged, files, inline, per vehicle; wrong ones are refused by field."""

import msgspec
import pyarrow.parquet as pq
import pytest
from paths import ROOT

from foundation.airframe.files import FOLDER, IRIS, load
from harness.launch.one_process import fly
from harness.scenario import scenario_file
from harness.scenario.scenario import Scenario, ScenarioError

HEXA = FOLDER / "hexacopter.toml"
CALM = 'agents = 2\n[wind]\nmean_n = 0.0\n[formation]\nshape = "line"\n'


def scenario(folder, text="", *overrides):
    path = folder / "mine.toml"
    path.write_text(CALM + text)
    return scenario_file.load(path, overrides)


def test_without_the_table_all_are_irises(tmp_path):
    assert scenario(tmp_path).airframes() == (IRIS, IRIS)


def test_one_is_named_for_all_or_for_one(tmp_path):
    loaded = scenario(
        tmp_path, '[vehicle]\nairframe = "x500"\n[vehicle.per_uav.1]\nairframe = "octocopter"\n'
    )
    assert loaded.airframes() == (load("x500"), load("octocopter"))
    assert (loaded.rotors(), loaded.most_rotors) == ((4, 8), 8)
    config = loaded.vehicle_config(1, run_id="r", radio_endpoint=None, log_path=None)
    assert config.airframe == load("octocopter")
    assert scenario(tmp_path, "", "vehicle.airframe=x500").airframes()[1] == load("x500")


def test_a_file_is_read_relative_to_the_scenario_and_travels_with_it(tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "own.toml").write_text(HEXA.read_text().replace("mass_kg = 1.53", "mass_kg = 1.7"))
    loaded = scenario(tmp_path, '[vehicle]\nairframe = "frames/own.toml"\n')
    again = msgspec.json.decode(msgspec.json.encode(loaded), type=Scenario)
    assert [airframe.mass_kg for airframe in again.airframes()] == [1.7, 1.7]


def test_an_airframe_within_the_scenario(tmp_path):
    table = HEXA.read_text().replace("[[rotors]]", "[[vehicle.airframes.own.rotors]]")
    for name in ("body", "propulsion", "battery"):
        table = table.replace(f"[{name}]", f"[vehicle.airframes.own.{name}]")
    text = f'[vehicle]\nairframe = "own"\n[vehicle.airframes.own]\n{table}'
    assert scenario(tmp_path, text).airframes() == (load("hexacopter"),) * 2
    with pytest.raises(ScenarioError, match=r"vehicle\.airframes\.own\.mass_kg: expected `float` >= 0\.0001"):
        scenario(tmp_path, text.replace("mass_kg = 1.53", "mass_kg = 0.0"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[vehicle]\nairframe = "x501"', "vehicle.airframe: there is no airframe 'x501'; expected one of"),
        ('[vehicle]\nairfame = "x500"', "vehicle: unknown key `airfame`; did you mean `vehicle.airframe`?"),
        ('[vehicle]\nairframe = "own.toml"', "vehicle.airframe: {folder}/own.toml: there is no such file"),
        (
            '[vehicle.per_uav.1]\nairframe = "wrong.toml"',
            "vehicle.per_uav.1.airframe: {folder}/wrong.toml: unknown key `mass`; did you mean `mass_kg`?",
        ),
        ('[vehicle.per_uav.5]\nairframe = "x500"', "vehicle.per_uav: there is no UAV '5' among 2"),
        (
            '[[faults]]\nkind = "motor_stop"\nuav = 1\nmotor = 4',
            "faults[0].motor: 4 is none of the 4 motors of UAV 1 from 0 on",
        ),
        (
            '[vehicle]\nairframe = "x500"\n[autopilot]\nkind = "px4"\npx4_build = "/px4"\npx4_vehicles = [1]',
            "vehicle.airframe: x500 for UAV 1, which runs px4 with the parameters of the Iris; expected iris",
        ),
        (
            '[vehicle]\nairframe = "flat.toml"',
            "vehicle.airframe: flat.toml: rotors: they cannot produce thrust, roll, pitch and yaw",
        ),
    ],
)
def test_a_wrong_choice_is_one_line_that_names_the_field(tmp_path, text, message):
    (tmp_path / "wrong.toml").write_text(HEXA.read_text().replace("mass_kg", "mass"))
    flat = HEXA.read_text()
    for number, row in enumerate(line for line in HEXA.read_text().splitlines() if "position" in line):
        flat = flat.replace(row, f"position_frd_m = [{0.2 * number:.1f}, 0.0, 0.0]")
    (tmp_path / "flat.toml").write_text(flat)
    with pytest.raises(ScenarioError) as caught:
        scenario(tmp_path, text + "\n")
    assert str(caught.value).startswith(f"{tmp_path}/mine.toml: {message.format(folder=tmp_path)}")


def test_the_spacing_follows_from_the_sizes(tmp_path):
    """Octocopters span 1.05 m and need 1.10 m, Crazyflies 0.19 m, one of each the mean."""
    near = "formation.spacing_m={}".format
    for spacing_m, first, second, fits in (
        (1.0, "octocopter", "octocopter", False),
        (1.2, "octocopter", "octocopter", True),
        (0.6, "octocopter", "crazyflie", False),
        (0.7, "octocopter", "crazyflie", True),
        (0.3, "crazyflie", "crazyflie", True),
    ):
        text = f'[vehicle]\nairframe = "{first}"\n[vehicle.per_uav.1]\nairframe = "{second}"\n'
        if fits:
            scenario(tmp_path, text, near(spacing_m))
        else:
            with pytest.raises(ScenarioError, match=r"places .* m apart; vehicles this size need"):
                scenario(tmp_path, text, near(spacing_m))


def test_the_table_of_the_flight_has_the_speeds_of_all_rotors(tmp_path):
    """The columns are those of the vehicle with most rotors; a quadrotor's other ones are 0."""
    text = '[vehicle.per_uav.1]\nairframe = "hexacopter"\n'
    fly(scenario(tmp_path, text, "onboard.localisation=gps"), tmp_path / "run", until_s=6.0)
    table = pq.read_table(tmp_path / "run" / "flight.parquet")
    columns = [name for name in table.column_names if name.startswith("rotor_speed_rad_s")]
    assert columns == [f"rotor_speed_rad_s.{k}" for k in range(6)]
    last = {uav: [table[name].to_pylist()[uav - 2] for name in columns] for uav in (0, 1)}
    assert min(last[0][:4]) > 90.0
    assert last[0][4:] == [0.0, 0.0]
    assert min(last[1]) > 75.0


def test_the_wheel_has_the_airframes():
    assert 'airframes = ["*.toml"]' in (ROOT / "pyproject.toml").read_text()

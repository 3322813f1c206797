"""The survey hexacopter flies from its file alone, also on five rotors; a wrong file is one line."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from coflight import OneProcessSwarm, ScenarioError, Swarm, load_scenario

FOLDER = Path(__file__).parents[1]
SCENARIO = FOLDER / "survey.toml"
CALM = ["wind.mean_n=0", "wind.gust_rms_fraction=0", 'sensors.profile="ideal"']
STOP_S = 20.0


def stopped(motor):
    return f'faults=[{{kind="motor_stop", uav=1, motor={motor}, start_s={STOP_S}}}]'


def test_the_formation_is_reached_and_held_after_a_motor_has_stopped(swarm):
    flight = swarm(SCENARIO)
    flight.run_until_formed(timeout_s=60.0)
    truth = flight.run(until_s=60.0)  # the motor stops at 40 s
    assert truth.alive.all()
    places_ned_m = flight.scenario.places_ned_m()
    offsets_m = truth.pos_ned_m - places_ned_m
    assert np.abs(offsets_m - offsets_m.mean(axis=0)).max() < 1.0  # the shape, without the GPS error of all
    assert flight.summary(draw=False)["collisions"] == 0


@pytest.mark.parametrize("motor", range(6))
def test_it_holds_its_place_in_calm_air_without_any_one_motor(swarm, motor, tmp_path):
    flight = swarm(SCENARIO, overrides=[*CALM, stopped(motor)], out=tmp_path / "run")
    before = flight.run(until_s=STOP_S).pos_ned_m[1]
    flight.run(until_s=STOP_S + 15.0)
    flight.summary(draw=False)
    columns = [f"pos_ned_m.{axis}" for axis in "ned"], [f"rotor_speed_rad_s.{k}" for k in range(6)]
    table = pq.read_table(tmp_path / "run" / "flight.parquet").to_pandas()
    rows = table[(table["uav"] == 1) & (table["time_us"] >= STOP_S * 1e6)]
    error_m = rows[columns[0]].to_numpy() - before
    assert np.sqrt((error_m**2).sum(axis=1).mean()) < 0.5
    speeds_rad_s = rows[columns[1]].to_numpy()[-1]
    assert speeds_rad_s[motor] < 1e-3
    assert speeds_rad_s.max() > 300.0


def test_the_flight_is_the_same_in_one_process_and_in_many(tmp_path):
    hashes = set()
    for kind in (Swarm, OneProcessSwarm):
        with kind(SCENARIO, seed=2, overrides=[stopped(4)], out=tmp_path / kind.__name__) as flight:
            flight.run(until_s=STOP_S + 3.0)
            hashes.add(flight.summary(draw=False)["log_sha256"])
    assert len(hashes) == 1


def test_a_heavier_load_than_the_rotors_carry_is_refused_with_file_and_field(tmp_path):
    for name in ("survey.toml", "heavy_hexacopter.toml"):
        shutil.copy(FOLDER / name, tmp_path)
    path = tmp_path / "heavy_hexacopter.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("mass_kg = 4.2\n", "mass_kg = 9.0\n"), encoding="utf-8")
    with pytest.raises(
        ScenarioError, match=r"vehicle\.airframe: .*heavy_hexacopter\.toml: .*hover"
    ) as caught:
        load_scenario(tmp_path / "survey.toml")
    assert "\n" not in str(caught.value)

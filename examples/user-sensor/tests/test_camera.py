"""The camera sees what is in front of it, the rotor shakes one UAV, and all runs are equal."""

import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from coflight import OneProcessSwarm, Swarm, UserFault
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load

SCENARIO = Path(__file__).parents[1] / "camera.toml"
EXACT = "sensors.extra.0.settings.noise_std_rad=0"


def columns(path, *names):
    table = pq.read_table(path).to_pydict()
    return [np.array(table[name]) for name in names]


def test_angles_are_those_of_the_nearest_uav_in_front(swarm, tmp_path):
    """The flight is recorded in each step; angles are compared at the time of the sample."""
    overrides = [EXACT, "run.record_rate_hz=250", "faults=[]"]
    flight = swarm(SCENARIO, overrides=overrides, out=tmp_path / "run")
    flight.run_until_formed(timeout_s=60)
    flight.summary(draw=False)
    time_us, uav, n, e, d, w, x, y, z = columns(
        tmp_path / "run" / "flight.parquet", "time_us", "uav", "pos_ned_m.n", "pos_ned_m.e", "pos_ned_m.d",
        "q_ned_frd.w", "q_ned_frd.x", "q_ned_frd.y", "q_ned_frd.z",
    )  # fmt: skip
    rows = {key: row for row, key in enumerate(zip(time_us.tolist(), uav.tolist(), strict=True))}
    places = np.stack((n, e, d), axis=1)
    at_us, measured_us, own, column, value = columns(
        tmp_path / "run" / "sensors.parquet", "time_us", "measured_us", "uav", "column", "value"
    )
    seen = 0
    for first in range(0, len(value), 3):
        assert list(column[first : first + 3]) == ["uav", "azimuth_rad", "elevation_rad"]
        assert 0 <= at_us[first] - measured_us[first] - 50_000 < 4_000
        key = int(measured_us[first])
        if (key, 0) not in rows:
            continue
        mine = rows[key, int(own[first])]
        towards = places[rows[key, int(value[first])]] - places[mine]
        qw, q = w[mine], -np.array((x[mine], y[mine], z[mine]))  # NED to FRD
        forward, right, down = towards + 2.0 * np.cross(q, np.cross(q, towards) + qw * towards)
        assert value[first + 1] == pytest.approx(math.atan2(right, forward), abs=1e-9)
        assert value[first + 2] == pytest.approx(math.asin(-down / np.linalg.norm(towards)), abs=1e-9)
        seen += 1
    assert seen > 100


def test_a_damaged_rotor_changes_the_estimate_of_its_uav_only_and_from_its_start_on(swarm, tmp_path):
    """UAV 1 hovers 8 s after the start; the others receive nothing of it within the next 40 ms."""
    found = []
    for name, overrides in (("sound", ["faults=[]"]), ("damaged", ["faults.0.start_s=8"])):
        out = tmp_path / name
        flight = swarm(SCENARIO, overrides=[*overrides, "run.record_rate_hz=250"], out=out)
        flight.run(until_s=8.04)
        flight.summary(draw=False)
        found.append(columns(out / "flight.parquet", "time_us", "uav", "estimator_vel_ned_m_s.n"))
    (time_us, uav, sound_m_s), (_, _, damaged_m_s) = found
    differs = ~((sound_m_s == damaged_m_s) | np.isnan(sound_m_s))
    assert set(uav[differs]) == {1}
    assert time_us[differs].min() == 8_000_000
    assert differs[(uav == 1) & (time_us >= 8_000_000)].all()


def test_a_fault_of_the_user_is_injected_by_its_name(swarm):
    flight = swarm(SCENARIO, overrides=["faults=[]"])
    flight.run(until_s=1.0)
    with pytest.raises(ValueError, match=r"fault\.settings\.amplitude_m_s2: expected `float` <= 50\.0"):
        flight.inject(UserFault(uav=1, model="vibration", settings={"amplitude_m_s2": 100.0}))
    flight.inject(UserFault(uav=1, model="vibration"))
    flight.run_for(0.1)
    assert flight.summary(draw=False)["status"] == "completed"


def test_a_wrong_setting_is_refused_when_the_scenario_is_read():
    expected = r"sensors\.extra\[0\]\.settings\.field_of_view_deg: expected `float` < 180\.0"
    with pytest.raises(ScenarioError, match=expected):
        load(SCENARIO, ["sensors.extra.0.settings.field_of_view_deg=200"])


def test_the_flight_is_the_same_in_one_process_and_in_many(tmp_path):
    hashes = set()
    for kind in (Swarm, OneProcessSwarm):
        with kind(
            SCENARIO, seed=2, overrides=["faults.0.start_s=10"], out=tmp_path / kind.__name__
        ) as flight:
            flight.run(until_s=14.0)
            hashes.add(flight.summary(draw=False)["log_sha256"])
    assert len(hashes) == 1

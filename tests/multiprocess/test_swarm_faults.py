"""What happens to a real swarm: vehicles that stop, a channel that is cut, ground stations that look in."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from pymavlink import mavutil  # noqa: TID251  the client that the tests are about

from harness.messages import VehicleLost, VehicleSilent
from harness.swarm import SwarmError

pytestmark = pytest.mark.multiprocess

ARTICLE = "scenarios/article.toml"


def test_a_vehicle_that_stops_answering_is_named_within_a_second_and_the_others_go_on(swarm):
    flight = swarm(ARTICLE, agents=3)
    flight.run_until(lambda truth: truth.height_m.min() > 2.0, timeout_s=30.0)
    os.kill(flight.pids["uav 2"], signal.SIGSTOP)
    wall_begin_s = time.monotonic()
    flight.run_for(0.1)
    assert time.monotonic() - wall_begin_s < 1.5  # the report after 0.5 s, and the steps themselves
    events = flight.events
    (lost,) = [event for event in events if isinstance(event, VehicleLost)]
    assert (lost.instance, lost.reason) == (2, "its process is stopped")
    assert [event.instance for event in events if isinstance(event, VehicleSilent)] == [2]
    truth = flight.run_until(lambda truth: truth.height_m[2] < 0.3, timeout_s=5.0)
    assert truth.alive.tolist() == [True, True, False]
    assert truth.height_m[:2].min() > 1.8
    flight.stop()
    assert flight.forced  # it could not end by itself, and is gone all the same (the fixture looks)


def test_a_scenario_may_end_with_the_first_loss(swarm):
    flight = swarm(ARTICLE, agents=2, overrides=["run.on_vehicle_loss=end"])
    flight.run_for(1.0)
    flight.kill(0)
    with pytest.raises(SwarmError, match=r"uav 0 was lost: its connection .*; run.on_vehicle_loss is 'end'"):
        flight.run_for(1.0)
    assert flight.summary(draw=False)["status"] == "failed"


def correction_ne_m(summary_folder, agents):
    """Times (T,) s and the applications' corrections (T, N, 2)."""
    table = pq.read_table(summary_folder / "flight.parquet").to_pydict()
    time_s = np.array(table["time_us"]).reshape(-1, agents)[:, 0] * 1e-6
    axes = [np.array(table[f"correction_ned_m.{axis}"]).reshape(-1, agents) for axis in "ne"]
    return time_s, np.stack(axes, axis=2)


def test_with_the_channel_cut_ranging_ends_and_the_correction_stops(swarm, tmp_path):
    flight = swarm(ARTICLE, agents=4, out=tmp_path / "run")
    flight.run_until_formed(timeout_s=60.0)
    flight.run_for(3.0)
    cut_s = flight.truth.t_s
    flight.cut_channel()
    flight.run_for(9.0)
    flight.restore_channel()
    restored_s = flight.truth.t_s
    flight.run_for(5.0)
    summary = flight.summary(draw=False)
    assert summary["collisions"] == 0
    sessions = pq.read_table(tmp_path / "run" / "ftm.parquet").to_pydict()
    at_s = np.array(sessions["measured_ns"]) * 1e-9
    fine = np.array(sessions["status"]) == "ok"
    grace_s = 0.2  # a session that was under way
    between = (at_s > cut_s + grace_s) & (at_s < restored_s)
    assert between.sum() > 12
    assert not fine[between].any()
    assert fine[at_s > restored_s + grace_s].any()

    time_s, correction_m = correction_ne_m(tmp_path / "run", 4)
    # cut off, the correction is still known for a while, but no longer repaired: its uncertainty grows
    table = pq.read_table(tmp_path / "run" / "flight.parquet").to_pydict()
    std_m = np.array(table["onboard_pos_std_m.n"]).reshape(-1, 4)
    at = [int(np.searchsorted(time_s, t)) for t in (cut_s, restored_s - 0.1, restored_s + 4.0)]
    assert (std_m[at[1]] > std_m[at[0]] + 0.02).all()
    assert np.isfinite(correction_m[at[0] :]).all()


def test_without_a_channel_from_the_start_there_is_no_correction_at_all(swarm, tmp_path):
    overrides = ["radio.extra_attenuation_db=200"]
    flight = swarm(ARTICLE, agents=3, overrides=overrides, out=tmp_path / "run")
    flight.run(until_s=20.0)
    summary = flight.summary(draw=False)
    assert summary["ftm"]["completed"] == 0  # nobody was ever heard, so nobody is even asked
    assert summary["frames"]["sent"] > 0
    assert summary["frames"]["delivered"] == 0
    _, correction_m = correction_ne_m(tmp_path / "run", 3)
    assert np.nanmax(np.abs(correction_m)) == 0.0


def test_a_ground_station_sees_every_vehicle_on_one_port(swarm):
    station = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    port = station.port.getsockname()[1]
    try:
        free = ["simulator_tcp", "gcs_local_udp", "companion_local_udp", "companion_remote_udp", "radio_tcp"]
        overrides = [f"ports.{name}=0" for name in free] + [f"ports.gcs_remote_udp={port}"]
        flight = swarm(ARTICLE, overrides=overrides, ports="scenario")
        seen = {}
        for _ in range(40):  # 4 s of simulated time; the station reads as it goes, as one does
            flight.run_for(0.1)
            while (message := station.recv_match(blocking=False)) is not None:
                seen.setdefault(message.get_srcSystem(), set()).add(message.get_type())
        assert sorted(seen) == list(range(1, 9))
        for kinds in seen.values():
            assert kinds >= {
                "HEARTBEAT",
                "ATTITUDE",
                "LOCAL_POSITION_NED",
                "GLOBAL_POSITION_INT",
                "GPS_RAW_INT",
            }
        # it only listened, so the run is what it would have been without it
        assert flight.summary(draw=False)["deterministic"] is True
    finally:
        station.close()


def test_an_autopilot_without_a_simulator_says_so_in_one_line():
    command = [sys.executable, "-m", "autopilot", "--instance", "77", "--connect-timeout-s", "0.3"]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60.0)
    assert result.returncode == 2
    assert result.stderr == "uav: no simulator at 127.0.0.1:4637 within 0.3 s (Connection refused)\n"


def test_the_launcher_flies_and_prints_the_summary_alone(tmp_path):
    launcher = Path(__file__).parents[2] / "scripts" / "launch_swarm.py"
    command = [sys.executable, str(launcher), str(Path(__file__).parents[2] / ARTICLE), "--agents", "2"]
    ports = [
        f"--set=ports.{name}=0"
        for name in ("simulator_tcp", "gcs_local_udp", "companion_local_udp", "radio_tcp")
    ]
    command += ["--duration", "1", "--seed", "3", "--json", "--out", str(tmp_path / "run"), *ports]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=200.0)
    assert result.returncode == 0, result.stderr
    assert result.stdout == (tmp_path / "run" / "summary.json").read_text()

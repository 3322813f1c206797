"""Real swarms with stopped processes, a cut channel, ground stations, and the launcher's command line."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import ROOT
from pymavlink import mavutil  # noqa: TID251  the client that the tests are about

from harness.launch.swarm import SwarmError, SwarmTimeoutError
from harness.simulator.messages import VehicleLost, VehicleSilent
from harness.simulator.process_activity import STOPPED_LIMIT_S

pytestmark = pytest.mark.multiprocess

ARTICLE = "scenarios/article.toml"
WALL_LIMIT_S = 15.0


@pytest.mark.parametrize("beacon_period_ms", [100, 10])  # at 10 ms a delivery is always in progress
def test_stopped_vehicle_is_reported_and_others_continue(swarm, beacon_period_ms):
    overrides = [f"onboard.beacon_period_ms={beacon_period_ms}", "onboard.localisation=gps"]
    flight = swarm(ARTICLE, agents=3, overrides=overrides)
    flight.run_until(lambda truth: truth.height_m.min() > 2.0, timeout_s=30.0)
    os.kill(flight.pids["uav 2"], signal.SIGSTOP)
    wall_begin_s = time.monotonic()
    flight.run_for(0.1)
    assert STOPPED_LIMIT_S < time.monotonic() - wall_begin_s < WALL_LIMIT_S
    events = flight.events
    (lost,) = [event for event in events if isinstance(event, VehicleLost)]
    assert (lost.instance, lost.reason) == (2, "its process is stopped")
    (silent,) = [event for event in events if isinstance(event, VehicleSilent)]
    assert silent.instance == 2
    assert silent.wall_silence_s < STOPPED_LIMIT_S  # reported before it is given up
    truth = flight.run_until(lambda truth: truth.height_m[2] < 0.3, timeout_s=5.0)
    assert truth.alive.tolist() == [True, True, False]
    assert truth.height_m[:2].min() > 1.8
    wall_begin_s = time.monotonic()
    flight.stop()
    assert flight.forced == ()  # it is continued in order to end
    assert time.monotonic() - wall_begin_s < 5.0


def test_stopped_prefork_server_does_not_delay_the_end(swarm):
    flight = swarm(ARTICLE, agents=2)
    flight.run_for(0.1)
    os.kill(flight.pids["prefork"], signal.SIGSTOP)
    wall_begin_s = time.monotonic()
    flight.stop()
    assert time.monotonic() - wall_begin_s < 5.0  # the time limit of a vehicle alone is 10 s
    assert flight.forced == ()
    assert flight.summary(draw=False)["status"] == "completed"


def test_scenario_can_end_with_the_first_loss(swarm):
    flight = swarm(ARTICLE, agents=2, overrides=["run.on_vehicle_loss=end"])
    flight.run_for(1.0)
    flight.kill(0)
    with pytest.raises(SwarmError, match=r"uav 0 was lost: its connection .*; run.on_vehicle_loss is 'end'"):
        flight.run_for(1.0)
    assert flight.summary(draw=False)["status"] == "failed"


def recorded_ne_m(folder, name, agents):
    """Return times (T,) in s and the horizontal part of a recorded vector (T, N, 2)."""
    table = pq.read_table(folder / "flight.parquet").to_pydict()
    time_s = np.array(table["time_us"]).reshape(-1, agents)[:, 0] * 1e-6
    return time_s, np.stack([np.array(table[f"{name}.{axis}"]).reshape(-1, agents) for axis in "ne"], axis=2)


def test_cut_channel_ends_ranging_and_freezes_the_correction(swarm, tmp_path):
    overrides = ["formation.rows=2", "formation.columns=2"]  # a row is localised later
    flight = swarm(ARTICLE, agents=4, overrides=overrides, out=tmp_path / "run")
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
    grace_s = 0.2  # of a session in progress
    between = (at_s > cut_s + grace_s) & (at_s < restored_s)
    assert between.sum() > 12
    assert not fine[between].any()
    assert fine[at_s > restored_s + grace_s].any()

    # the contribution of ranging to the correction varies, is constant when the last distance is older than
    # 3 s, and varies again with new distances
    time_s, offset_ne_m = recorded_ne_m(tmp_path / "run", "odometry_offset_ned_m", 4)
    ranging_silence_s = 3.0
    before = (time_s > cut_s - 3.0) & (time_s < cut_s)
    cut_off = (time_s > cut_s + grace_s + ranging_silence_s) & (time_s < restored_s)
    restored = time_s > restored_s + 1.0
    assert cut_off.sum() > 125
    assert (np.ptp(offset_ne_m[cut_off], axis=0) == 0.0).all()
    for moving in (before, restored):
        assert (np.ptp(offset_ne_m[moving], axis=0).max(axis=1) > 0.02).all()


def test_without_a_channel_the_correction_is_zero(swarm, tmp_path):
    overrides = ["radio.extra_attenuation_db=200"]
    flight = swarm(ARTICLE, agents=3, overrides=overrides, out=tmp_path / "run")
    flight.run(until_s=20.0)
    summary = flight.summary(draw=False)
    assert summary["ftm"]["completed"] == 0  # no beacon was received, so no session is requested
    assert summary["frames"]["sent"] > 0
    assert summary["frames"]["delivered"] == 0
    _, correction_ne_m = recorded_ne_m(tmp_path / "run", "correction_ned_m", 3)
    assert np.nanmax(np.abs(correction_ne_m)) == 0.0
    _, offset_ne_m = recorded_ne_m(tmp_path / "run", "odometry_offset_ned_m", 3)
    assert np.isnan(offset_ne_m).all()


def test_ground_station_receives_every_vehicle_on_one_port(swarm):
    station = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    port = station.port.getsockname()[1]
    try:
        free = ["simulator_tcp", "gcs_local_udp", "companion_local_udp", "companion_remote_udp", "radio_tcp"]
        overrides = [f"ports.{name}=0" for name in free] + [f"ports.gcs_remote_udp={port}"]
        flight = swarm(ARTICLE, overrides=overrides, ports="scenario")
        seen = {}
        for _ in range(40):  # 4 s of simulated time; the station reads continuously
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
        # the station did not send, so the run is deterministic
        assert flight.summary(draw=False)["deterministic"] is True
    finally:
        station.close()


def test_killed_vehicle_with_input_of_a_station_marks_the_run(swarm):
    flight = swarm(ARTICLE, agents=2)
    flight.run_for(0.5)
    link = flight.mavlink(1)
    flight.run_until(lambda _: link.recv_match(blocking=False) is not None, timeout_s=2.0)
    flight.kill(1)
    flight.run_for(0.1)
    summary = flight.summary(draw=False)
    assert summary["deterministic"] is False
    manifest = json.loads((flight.path / "manifest.json").read_text())
    assert manifest["nondeterminism"] == ["uav 1 received messages from a ground station or companion"]


def test_paused_emulator_causes_no_loss(swarm):
    flight = swarm(ARTICLE, agents=2, overrides=["run.silence_limit_s=0.5"])
    flight.run_for(1.0)
    os.kill(flight.pids["radio"], signal.SIGSTOP)
    threading.Timer(2.0, os.kill, (flight.pids["radio"], signal.SIGCONT)).start()
    truth = flight.run_for(1.0)
    assert truth.alive.all()
    assert flight.summary(draw=False)["deterministic"] is True


def test_interrupted_run_cannot_be_continued_and_is_marked(swarm):
    flight = swarm(ARTICLE, agents=2)
    flight.run_for(0.5)
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        flight.run_for(600.0)
    with pytest.raises(SwarmError, match="interrupted by its user"):
        flight.run_for(0.5)
    summary = flight.summary(draw=False)
    assert (summary["status"], summary["deterministic"]) == ("interrupted", False)
    assert summary["reason"] == "the run was interrupted by its user"


def test_late_formation_is_reported(swarm):
    flight = swarm(ARTICLE, agents=2, overrides=["wind.mean_n=0"])
    with pytest.raises(SwarmTimeoutError, match="within 1 s"):
        flight.run_until_formed(timeout_s=1.0)
    flight.run_until_formed(timeout_s=60.0)
    summary = flight.summary(draw=False)
    assert (summary["status"], summary["deterministic"]) == ("completed", True)


def test_launcher_runs_without_applications(tmp_path):
    ports = [
        f"--set=ports.{name}=0"
        for name in ("simulator_tcp", "gcs_local_udp", "companion_local_udp", "radio_tcp")
    ]
    options = ["--agents=1", "--duration=1.5", "--set=onboard.enabled=false"]
    summary = json.loads(finish(launch(tmp_path / "run", *options, *ports)))
    assert (summary["status"], summary["simulated_s"]) == ("completed", pytest.approx(1.5, abs=0.01))


def test_killed_radio_ends_the_run_with_its_name(swarm):
    flight = swarm(ARTICLE, agents=2)
    flight.run_for(1.0)
    os.kill(flight.pids["radio"], signal.SIGKILL)
    with pytest.raises(SwarmError, match=r"radio \(pid \d+\) was killed by SIGKILL"):
        flight.run_for(30.0)


def test_autopilot_without_a_simulator_is_one_line():
    command = [sys.executable, "-m", "autopilot", "--instance", "77", "--connect-timeout-s", "0.3"]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60.0)
    assert result.returncode == 2
    assert result.stderr == "uav: no simulator at 127.0.0.1:4637 within 0.3 s (Connection refused)\n"


LAUNCHER = ROOT / "scripts" / "launch_swarm.py"
ARTICLE_PATH = ROOT / ARTICLE


LOW = ("--set=formation.height_m=2", "--set=onboard.localisation=gps")  # reached sooner


def launch(out, *options):
    """Start the launcher's process, which prints the summary on its stdout."""
    command = [sys.executable, str(LAUNCHER), str(ARTICLE_PATH), "--json", "--out", str(out), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(launched):
    """Wait for the launcher; returns its output. The exit status must be 0."""
    out, err = launched.communicate(timeout=200.0)
    assert launched.returncode == 0, err
    return out


def test_two_launchers_at_once_fly_on_different_ports_and_print_their_summaries_alone(tmp_path):
    names = ("one", "other")
    launched = [launch(tmp_path / name, "--agents=2", *LOW, "--duration=1") for name in names]
    printed = [finish(each) for each in launched]
    assert printed == [(tmp_path / name / "summary.json").read_text() for name in names]
    summaries = [json.loads(text) for text in printed]
    assert summaries[0]["log_sha256"] == summaries[1]["log_sha256"]
    assert all(summary["deterministic"] and summary["agents"] == 2 for summary in summaries)
    manifests = [json.loads((tmp_path / name / "manifest.json").read_text()) for name in names]
    first, second = (manifest["scenario"]["ports"]["simulator_tcp"] for manifest in manifests)
    assert first != second

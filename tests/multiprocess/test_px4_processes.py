"""Swarms with stand-ins for PX4: flights, losses, errors at the start, end with the run."""

import json
import socket
import subprocess
import sys
import textwrap
import time

import psutil
import pytest
from external_swarms import CALM
from paths import ROOT
from px4_swarms import px4_swarms
from pymavlink.dialects.v20 import common

from harness.launch.one_process import OneProcessSwarm
from harness.launch.process_commands import PREFORK, application, uav
from harness.launch.swarm import SetupError, SwarmError
from harness.simulator.messages import VehicleLost

pytestmark = pytest.mark.multiprocess


@pytest.fixture
def swarm(tmp_path):
    """Return a factory of swarms of stand-ins; ``**manners`` are fields of `px4_stand_in.Manners`."""
    path = tmp_path / "px4s.toml"
    path.write_text(CALM, encoding="ascii")
    return px4_swarms(tmp_path, path)


def test_swarm_of_px4s_flies_the_formation_and_is_not_deterministic(swarm):
    flown = swarm(3, speed=2.0, flies=True, late_every=500)
    with flown:
        flown.run_until_formed(timeout_s=90.0)
        # GPS has no error here: the rest is the hold, and the application's delay on a busy machine
        flown.run_until(lambda truth: truth.error_m.max() < 0.7, timeout_s=10.0)
        truth = flown.run_for(1.0)
        assert [event for event in flown.events if isinstance(event, VehicleLost)] == []
        assert all(vehicle.alive and vehicle.armed for vehicle in truth.vehicles)
        # the application reports its own phase and PX4's mode to the simulator
        assert {vehicle.mode for vehicle in truth.vehicles} == {"Offboard"}
        assert {vehicle.phase for vehicle in truth.vehicles} == {"on station"}
        summary = flown.summary(draw=False)
    assert flown.forced == ()
    assert flown.leftovers() == []
    assert summary["status"] == "completed"
    assert not summary["deterministic"]
    manifest = json.loads((flown.path / "manifest.json").read_text())
    assert [line for line in manifest["nondeterminism"] if "flown by a PX4" in line] == [
        f"uav {i} is flown by a PX4, whose threads depend on the machine" for i in range(3)
    ]
    details = {process["name"]: process["details"] for process in manifest["processes"]}
    # a step waits 200 ms; steps continue without an answer only on a busy machine
    assert sum(details["physics"]["late_answers"].values()) <= 5
    for i in range(3):
        assert details[application(i)]["malformed_bytes"] == 0
        assert details[application(i)]["bad_beacons"] == 0
        assert "px4" in (flown.path / "logs" / f"uav-{i}.log").read_text()
        assert (flown.path / "px4" / f"uav-{i}").is_dir()
    # beacons crossed the emulated channel, and estimates are recorded
    assert summary["frames"]["delivered"] > 100
    assert all(vehicle["absolute_rms_m"] is not None for vehicle in summary["vehicles"])


def test_px4_and_own_autopilot_fly_in_one_formation(swarm):
    flown = swarm(2, "autopilot.px4_vehicles=[1]", speed=2.0, flies=True)
    with flown:
        flown.run_until_formed(timeout_s=90.0)
        flown.run_until(lambda truth: truth.error_m.max() < 0.7, timeout_s=10.0)
        summary = flown.summary(draw=False)
    assert not summary["deterministic"]
    assert set(flown.pids) == {"radio", "physics", PREFORK, uav(0), uav(1), application(1)}


def test_a_range_finder_reaches_the_autopilot_over_a_px4s_simulator_link(swarm):
    """The stand-in passes all bytes of the link to coflight's autopilot, which streams the readings."""
    finder = "sensors.extra=[{model='range_finder', settings={min_m=0.0, noise_std_m=0.0}}]"
    with swarm(1, "onboard.enabled=false", finder, speed=2.0, flies=True) as flown:
        station = flown.mavlink(0)
        flown.run_until(lambda truth: truth.t_s > 6.0, timeout_s=10.0)
        reading = station.recv_match(type="DISTANCE_SENSOR", blocking=True, timeout=5.0)
        height_m = float(flown.truth.height_m[0])
    assert reading is not None
    assert (reading.get_srcSystem(), reading.id) == (1, 0)
    assert reading.orientation == common.MAV_SENSOR_ROTATION_PITCH_270
    assert reading.current_distance == round(100.0 * height_m)
    assert reading.signal_quality == 100


def test_px4s_without_applications_leave_their_companion_ports_free(swarm):
    flown = swarm(2, "onboard.enabled=false", armed_from=200)
    with (
        flown,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as others,
    ):
        others.bind(("127.0.0.1", flown.scenario.ports.companion_remote_udp))
        truth = flown.run_for(2.0)
        assert all(vehicle.alive and vehicle.armed for vehicle in truth.vehicles)
    assert flown.leftovers() == []


def test_killed_px4_is_reported_as_lost_and_others_continue(swarm):
    flown = swarm(2)
    with flown:
        flown.run_for(0.5)
        pid = flown._processes.ready[uav(0)].pid  # PX4's own, not that of harness.launch.external_process
        assert "px4" in " ".join(psutil.Process(pid).cmdline())
        psutil.Process(pid).kill()
        truth = flown.run_for(1.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [False, True]
        (lost,) = (event for event in flown.events if isinstance(event, VehicleLost))
        assert (lost.instance, lost.reason) == (0, "its connection closed")
        flown.kill(1)
        with pytest.raises(Exception, match="no vehicle is left"):
            flown.run_for(1.0)
    assert flown.leftovers() == []


def test_px4_without_answers_is_reported_as_lost(swarm):
    flown = swarm(1, mute_from=50)
    with flown, pytest.raises(Exception, match="no vehicle is left"):
        flown.run_for(20.0)
    (lost,) = (event for event in flown.events if isinstance(event, VehicleLost))
    assert "has not answered" in lost.reason


def test_px4_continues_after_the_end_of_its_application(swarm):
    flown = swarm(2, speed=2.0, flies=True)
    with flown:
        flown.run_until(
            lambda truth: min(vehicle.pos_ned_m[2] for vehicle in truth.vehicles) < -1.0, timeout_s=60.0
        )
        psutil.Process(flown.pids[application(0)]).kill()
        # its radio is offered the other's beacons and does not answer
        truth = flown.run_for(3.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True, True]
        # PX4's own failsafe is active, since its setpoints have ended
        assert truth.vehicles[0].armed
        assert truth.vehicles[1].phase in {"joining", "on station"}
    assert not any(isinstance(event, VehicleLost) for event in flown.events)


def test_px4_that_ends_at_once_is_reported_with_its_output(swarm, tmp_path):
    flown = swarm(2)
    (tmp_path / "build" / "bin" / "px4").write_text("#!/bin/sh\necho 'ERROR no such model'\nexit 3\n")
    begin_s = time.monotonic()
    with pytest.raises(SwarmError, match=r"^uav \d .* ended with status 3: ERROR no such model[^\n]*$"):
        flown.start()
    assert time.monotonic() - begin_s < 60.0
    assert flown.leftovers() == []


def test_one_process_refuses_a_px4(swarm, tmp_path):
    with pytest.raises(SetupError, match="one process cannot hold it"):
        OneProcessSwarm(swarm(1).scenario, out=tmp_path / "one").start()


def test_ports_that_px4_does_not_have_are_reported_and_leave_no_folder(swarm):
    flown = swarm(1, "ports.simulator_tcp=5000", "autopilot.px4_command=['env', '{build}/bin/px4']")
    with pytest.raises(SetupError, match=r"^ports\.\w+: a PX4 listens on [^\n]*$"):
        flown.start()
    assert not flown.path.exists()


def test_port_in_use_of_the_application_is_reported_before_the_start(swarm):
    flown = swarm(1)
    port = flown.scenario.ports.companion_remote_udp
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        with pytest.raises(SetupError, match=f"^UDP port {port} on 127.0.0.1: [^\n]*$"):
            flown.start()
    assert flown.pids == {}


def test_external_process_ends_with_its_parent_process(tmp_path):
    """The program ends too, not only `harness.launch.external_process`, which runs it."""
    pids = tmp_path / "pids"
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(f"""
        import os, signal, time
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a PX4 may hang at SIGTERM
        open({str(pids)!r}, "w").write(str(os.getpid()))
        time.sleep(600)
        """),
        encoding="ascii",
    )
    config = {
        "name": "uav 0", "command": [sys.executable, str(program)], "environment": {},
        "folder": str(tmp_path),
    }  # fmt: skip
    (tmp_path / "program.json").write_text(json.dumps(config), encoding="ascii")
    command = [
        sys.executable,
        "-P",
        "-m",
        "harness.launch.external_process",
        "--config",
        str(tmp_path / "program.json"),
    ]
    for way in ("stdin", "kill", "stop"):
        pids.unlink(missing_ok=True)
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT) as runner:
            ready = json.loads(runner.stdout.readline())
            deadline_s = time.monotonic() + 20.0
            while not (pids.exists() and pids.read_text()) and time.monotonic() < deadline_s:
                time.sleep(0.02)
            program_process = psutil.Process(int(pids.read_text()))
            assert ready["pid"] == program_process.pid
            if way == "stop":
                runner.stdin.write(b'{"command":"stop"}\n')
                runner.stdin.flush()
            elif way == "stdin":
                runner.stdin.close()
            else:
                runner.kill()
            program_process.wait(10.0)
            runner.wait(10.0)

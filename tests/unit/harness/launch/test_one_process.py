"""A swarm in one process has the interface of a swarm, and delivers nothing before its time.

multiprocess/test_swarm_determinism.py compares its logs with those of a swarm of many processes.
"""

import dataclasses
import errno
import json
import math
import multiprocessing
import os
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from types import SimpleNamespace

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.vehicle.vehicle import Vehicle
from foundation.exit_status import FINE
from foundation.records.record_log import BLOCK_ROWS
from harness.cli.fly import main
from harness.launch import kernel_cache
from harness.launch.one_process import OneProcessSwarm, fly
from harness.launch.run_messages import SwarmError
from harness.records.run_folder import RunFolder
from harness.records.tables import flight_in, read_flight
from harness.report import antenna_report, report
from harness.report.flown_array import gain_series
from harness.scenario.scenario_file import load
from harness.simulator.emulator_client import EmulatorClient
from harness.simulator.in_process_links import InProcessEmulatorLine, InProcessRadio
from harness.simulator.messages import Progress, VehicleLost
from netsim.emulator.service import EmulatorService
from netsim.model.config import RadioConfig, ServerConfig
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.messages import MAX_PAYLOAD_BYTES, Broadcast, Delivery

ARTICLE = SCENARIOS / "article.toml"
STEP_US = 4_000
RADIO = {"extra_attenuation_db": 0.0, "range_offsets_m": {}}


def scenario(*settings, agents=2, seed=3):
    return load(ARTICLE, [f"agents={agents}", f"run.seed={seed}", *settings])


def radio_table(folder):
    return pq.read_table(folder / "radio.parquet").to_pydict()


def flight_table(folder):
    return pq.read_table(folder / "flight.parquet").to_pydict()


def test_equal_flights_give_equal_logs_and_other_seeds_others(tmp_path):
    hashes = {
        name: fly(scenario(seed=seed), tmp_path / name, until_s=3.0)["log_sha256"]
        for name, seed in (("first", 3), ("again", 3), ("other", 4))
    }
    assert hashes["first"] == hashes["again"] != hashes["other"]


def test_the_logs_do_not_depend_on_the_division_into_runs(tmp_path):
    """Commands come between steps: one run of 4 s, or six and a condition, are 1000 steps.

    From 3 s on the radios are used, and some runs end within an interval of the channel.
    """
    whole = fly(scenario(), tmp_path / "whole", until_s=4.0)
    with OneProcessSwarm(scenario(), out=tmp_path / "parts") as swarm:
        swarm.run_for(0.004)
        swarm.run(until_s=0.5)
        swarm.run_until(lambda truth: truth.t_s >= 1.2, timeout_s=5.0, every_s=0.1)
        assert swarm.truth.time_us == 1_200_000
        for until_s in (3.004, 3.52, 4.0):
            swarm.run(until_s=until_s)
        parts = swarm.summary(draw=False)
    assert whole["simulated_s"] == parts["simulated_s"] == 4.0
    assert radio_table(tmp_path / "parts")["start_ns"]
    assert whole["log_sha256"] == parts["log_sha256"]


def test_captures_do_not_change_the_logs_and_are_reproducible(tmp_path):
    def flown(name, *settings):
        summary = fly(scenario(*settings), tmp_path / name, until_s=3.5)
        capture = RunFolder(tmp_path / name).capture
        return summary["log_sha256"], capture.read_bytes() if capture.exists() else None

    log, nothing = flown("off")
    assert nothing is None
    medium, receivers = flown("medium", "radio.capture=true"), flown("receivers", "radio.capture=receivers")
    assert medium[0] == receivers[0] == log
    assert len(receivers[1]) > len(medium[1]) > 0
    assert flown("again", "radio.capture=receivers") == receivers


@pytest.mark.parametrize(
    "setting",
    [
        "onboard.loop_period_ms=4",
        "onboard.loop_period_ms=40",
        'radio.guests=[{name="ground", pos_ned_m=[0.0, -20.0, -1.5]}]',
    ],
)
def test_everything_is_delivered_for_any_interval_of_the_channel(setting, tmp_path):
    """With guests an interval is one step, whatever the period of the applications' loop."""
    summary = fly(scenario(setting), tmp_path / "run", until_s=4.5)
    assert summary["ftm"]["completed"] == summary["ftm"]["requested"] > 0
    frames = radio_table(tmp_path / "run")
    delivered = [n for n, kind in zip(frames["delivered"], frames["kind"], strict=True) if kind == "data"]
    assert len(delivered) > 40
    assert all(delivered)


def test_two_flights_in_one_process_do_not_disturb_each_other(tmp_path):
    alone = fly(scenario(), tmp_path / "alone", until_s=2.0)
    results = {}

    def run(name, seed):
        results[name] = fly(scenario(seed=seed), tmp_path / name, until_s=2.0)["log_sha256"]

    threads = [threading.Thread(target=run, args=each) for each in (("same", 3), ("other", 4))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results["same"] == alone["log_sha256"] != results["other"]


def test_flights_run_in_parallel_in_processes_of_their_own(tmp_path):
    """Spawned workers find the cache of compiled kernels."""
    names = ("left", "right")
    alone = fly(scenario(), tmp_path / "alone", until_s=1.0)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        flights = [pool.submit(fly, scenario(), tmp_path / name, until_s=1.0) for name in names]
        hashes = [flight.result()["log_sha256"] for flight in flights]
    assert hashes == 2 * [alone["log_sha256"]]


def test_the_manifest_names_one_process_and_the_folder_holds_a_run(tmp_path):
    with OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm:
        swarm.run(until_s=1.0)
        assert set(swarm.pids.values()) == {os.getpid()}
        summary = swarm.summary(draw=False)
    assert summary["deterministic"]
    (process,) = json.loads((tmp_path / "run" / "manifest.json").read_bytes())["processes"]
    assert process["pid"] == os.getpid()
    assert process["ending"] == f"one process (pid {os.getpid()}) ended with status 0"
    assert process["details"]["time_us"] == 1_000_000
    assert {"radio", "uav 0", "uav 1"} <= process["details"].keys()
    # 25 records of each vehicle in a second: at 40 ms, 80 ms ... before 1 s, where the next step begins
    assert len(flight_table(tmp_path / "run")["time_us"]) == 2 * 24
    assert swarm.leftovers() == []
    with pytest.raises(SwarmError, match="a run already"), OneProcessSwarm(scenario(), out=tmp_path / "run"):
        pass


def test_a_cut_channel_delivers_nothing_from_its_interval_on_and_a_restored_one_does(tmp_path):
    """A frame in flight keeps the power of its start, so frames are counted by their start times.

    The commands come within intervals of 40 ms; the next intervals begin at 4 and 5 s.
    """
    with OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm:
        for cut, until_s in ((False, 3.992), (True, 4.988), (False, 6.0)):
            swarm.cut_channel() if cut else swarm.restore_channel()
            swarm.run(until_s=until_s)
        swarm.summary(draw=False)
    frames = radio_table(tmp_path / "run")
    starts_s, delivered = np.array(frames["start_ns"]) * 1e-9, np.array(frames["delivered"])
    during = (starts_s >= 4.0) & (starts_s < 5.0)
    assert during.sum() > 5
    assert not delivered[during].any()
    for outside in (starts_s < 4.0, starts_s >= 5.0):
        assert delivered[outside].any()


def test_an_attenuation_out_of_range_is_refused_and_the_run_continues(tmp_path):
    with OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm:
        for attenuation_db in (-5.0, 1_500.0, math.inf, math.nan):
            with pytest.raises(
                ValueError, match=rf"^attenuation_db {attenuation_db:g}: expected 0 to 1000 dB$"
            ):
                swarm.degrade_channel(attenuation_db)
        for attenuation_db in (0.0, 1_000.0):
            swarm.degrade_channel(attenuation_db)
            swarm.run_for(0.1)
        swarm.summary(draw=False)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_bytes())
    assert [line.partition(": ")[2] for line in manifest["interventions"]] == [
        "attenuate the channel by 0 dB",
        "attenuate the channel by 1000 dB",
    ]


def test_a_killed_vehicle_is_lost_from_the_next_step_on_and_the_others_fly_on(tmp_path):
    """Its log keeps whole blocks of 64 rows, as that of a killed process: of 74 rows in 3 s there are 64."""
    with OneProcessSwarm(scenario(agents=3), out=tmp_path / "run") as swarm:
        swarm.run(until_s=3.0)
        swarm.kill(1)
        swarm.run(until_s=3.5)
        assert [vehicle.alive for vehicle in swarm.truth.vehicles] == [True, False, True]
        assert [(e.time_us, e.instance) for e in swarm.events if isinstance(e, VehicleLost)] == [
            (3_000_000, 1)
        ]
        rows = [path.stat().st_size // VEHICLE_RECORD.itemsize for path in uav_logs(swarm)]
        assert rows[1] == BLOCK_ROWS
        summary = swarm.summary(draw=False)
    assert summary["deterministic"]
    reasons = [vehicle["lost"] for vehicle in summary["vehicles"]]
    assert reasons[::2] == [None, None]
    assert reasons[1].endswith(", t = 3.00 s")
    frames = radio_table(tmp_path / "run")
    sent_s = np.array(frames["start_ns"])[np.array(frames["source"]) == 1] * 1e-9
    assert (sent_s < 3.0 + 0.02).all()  # except a frame that was being sent


@pytest.mark.parametrize("columns", [4, 2])
def test_a_line_is_warned_of_once_before_the_flight_and_a_triangle_is_not(columns, tmp_path):
    messages = []
    flown = scenario(f"formation.columns={columns}", agents=3)
    with OneProcessSwarm(flown, out=tmp_path / "run", on_message=messages.append) as swarm:
        swarm.run(until_s=0.1)
    warned = [message for message in messages if getattr(message, "text", "").startswith("warning: ")]
    assert len(warned) == (columns == 4)
    assert not warned or messages[0] is warned[0]


def uav_logs(swarm):
    return [swarm.path / "raw" / f"uav-{i}.bin" for i in range(swarm.scenario.agents)]


def test_the_loss_of_every_vehicle_ends_the_run(tmp_path):
    with OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm:
        swarm.run(until_s=1.0)
        for i in range(2):
            swarm.kill(i)
        with pytest.raises(SwarmError, match="no vehicle is left"):
            swarm.run(until_s=2.0)
        assert swarm.summary(draw=False)["status"] == "failed"


def test_an_error_in_a_vehicle_ends_the_run_and_its_traceback_is_in_the_log(tmp_path, monkeypatch):
    step = Vehicle.step

    def fall(self, **inputs):
        if self.config.instance == 1 and inputs["sim_messages"][-1].time_usec == 500_000:
            raise ZeroDivisionError("of the test")
        return step(self, **inputs)

    monkeypatch.setattr(Vehicle, "step", fall)
    with OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm:
        with pytest.raises(SwarmError, match=r"ZeroDivisionError: of the test \(log: .*one-process.log\)"):
            swarm.run(until_s=1.0)
        with pytest.raises(SwarmError):
            swarm.run(until_s=2.0)
        summary = swarm.summary(draw=False)
    assert summary["status"] == "failed"
    assert "in fall" in (tmp_path / "run" / "logs" / "one-process.log").read_text()
    rows = flight_table(tmp_path / "run")["time_us"]
    assert max(rows) == 480_000  # the records up to then, every 40 ms, are complete


def falling(monkeypatch, error, *, before=lambda: None):
    """Let the second vehicle raise an error at 0.5 s, after calling ``before``."""
    step = Vehicle.step

    def fall(self, **inputs):
        if self.config.instance == 1 and inputs["sim_messages"][-1].time_usec == 500_000:
            before()
            raise error
        return step(self, **inputs)

    monkeypatch.setattr(Vehicle, "step", fall)


def test_an_error_that_cannot_be_logged_ends_the_run_too(tmp_path, monkeypatch):
    """As on a full disk: the run would otherwise wait for its flight until its wall-time limit."""
    folder = tmp_path / "run"
    falling(monkeypatch, ZeroDivisionError("of the test"), before=lambda: shutil.rmtree(folder / "logs"))
    with (
        OneProcessSwarm(scenario(), out=folder, wall_limit_s=30.0) as swarm,
        pytest.raises(SwarmError, match="ZeroDivisionError: of the test"),
    ):
        swarm.run(until_s=1.0)
    assert not (folder / "logs").exists()


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), MemoryError()], ids=repr)
def test_lack_of_disk_space_or_memory_is_not_a_failed_run(tmp_path, monkeypatch, error):
    falling(monkeypatch, error)
    with pytest.raises(type(error)) as caught:
        fly(scenario(), tmp_path / "run", until_s=1.0)
    assert caught.value is error


def test_a_flight_computes_gains_on_one_processor_and_a_swarm_on_all(tmp_path, monkeypatch):
    threads = []

    def count(*arguments, workers, with_grids):
        threads.append(workers)
        return gain_series(*arguments, with_grids=with_grids)

    monkeypatch.setattr(antenna_report, "gain_series", count)
    monkeypatch.setattr(antenna_report.os, "cpu_count", lambda: 5)
    fly(scenario(), tmp_path / "fly", until_s=0.1)
    with OneProcessSwarm(scenario(), out=tmp_path / "swarm") as swarm:
        swarm.run(until_s=0.1)
        swarm.summary(draw=False)
    assert threads == [1, 5]


def test_a_flight_is_read_back_as_it_was_reported(tmp_path, monkeypatch):
    reported = []

    def note(*arguments, **named):
        reported.append(flight_in(*arguments, **named))
        return reported[-1]

    monkeypatch.setattr(report, "flight_in", note)
    flown = scenario("onboard.localisation=gps", agents=3)
    fly(flown, tmp_path, until_s=1.0)
    again = read_flight(RunFolder(tmp_path), flown)
    assert len(again) == 24  # 25 records in a second, at 40 ms, 80 ms ... before 1 s
    for name in {field.name for field in dataclasses.fields(again)} - {"release"}:
        np.testing.assert_array_equal(getattr(again, name), getattr(reported[0], name))


def test_an_interrupted_run_is_reported_and_leaves_no_thread(tmp_path):
    def interrupt(message):
        if isinstance(message, Progress):  # after 0.2 s of wall time
            raise KeyboardInterrupt

    before = set(threading.enumerate())
    with OneProcessSwarm(scenario(), out=tmp_path / "run", on_message=interrupt) as swarm:
        with pytest.raises(KeyboardInterrupt):
            swarm.run(until_s=10_000.0)
        summary = swarm.summary(draw=False, interrupted=True)
    assert summary["status"] == "interrupted"
    assert not summary["deterministic"]
    assert 0.0 < summary["simulated_s"] < 10_000.0
    assert set(threading.enumerate()) <= before


def test_a_formation_that_is_not_reached_is_a_result(tmp_path):
    summary = fly(scenario("run.reach_timeout_s=0.5"), tmp_path / "run")
    assert summary["status"] == "not_formed"
    assert summary["simulated_s"] == 0.504  # from the first step on, which is at 4 ms


def test_a_link_to_the_outside_is_refused(tmp_path):
    with (
        OneProcessSwarm(scenario(), out=tmp_path / "run") as swarm,
        pytest.raises(SwarmError, match="no link"),
    ):
        swarm.mavlink(0)


def test_the_command_line_flies_in_its_own_process(tmp_path, capfd):
    """Without the application there is no formation, so the run is as long as its duration."""
    out = tmp_path / "run"
    settings = ["--agents", "2", "--duration", "0.2", "--set", "onboard.enabled=false"]
    status = main([str(ARTICLE), "--one-process", "--json", "--out", str(out), *settings])
    streams = capfd.readouterr()
    assert status == FINE, streams.err
    assert json.loads(streams.out)["simulated_s"] == 0.204  # from the first step on, which is at 4 ms
    assert "one process is ready" in streams.err


class Channel:
    """Two stations 10 m apart, with the connections of the time master and of both radios."""

    def __init__(self):
        config = ServerConfig(run_id="test", stations=2, seed=1, radio=RadioConfig(rician_k_db=None))
        self.emulator = EmulatorService(config)
        self.radios = [InProcessRadio(self.emulator, i) for i in range(2)]
        self.line = InProcessEmulatorLine(self.emulator, self.radios)

    def received(self, station, now_us):
        """Return the datagrams that are released to a station by now."""
        return [item for item in self.radios[station].receive(now_us) if isinstance(item, Delivery)]

    def advance(self, time_us, **changes):
        request = Advance(
            to_us=time_us + STEP_US,
            release_us=time_us + 2 * STEP_US,
            at_us=time_us,
            pos_ned_m=pack_rows(np.array([[0.0, 0.0, -10.0], [10.0, 0.0, -10.0]])),
            vel_ned_m_s=pack_rows(np.zeros((2, 3))),
            q_ned_frd=pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))),
            extra_attenuation_db=0.0,
        )
        self.line.send(msgspec.structs.replace(request, **changes))
        return self.line.receive()


def test_datagrams_that_the_wire_refuses_are_refused_here_too():
    """1472 bytes are the largest datagram; the emulator's process would drop a larger one."""
    channel = Channel()
    channel.radios[0].send(STEP_US, [Broadcast(seq=0, at_us=STEP_US, payload=bytes(MAX_PAYLOAD_BYTES))])
    with pytest.raises(ValueError, match=r"station 0: the 802\.11 emulator rejects"):
        channel.radios[0].send(
            STEP_US, [Broadcast(seq=1, at_us=STEP_US, payload=bytes(1 + MAX_PAYLOAD_BYTES))]
        )


def test_a_datagram_is_received_at_its_release_and_not_before():
    """It is handed over at 4 ms, sent before 8 ms and released one step later, at 12 ms."""
    channel = Channel()
    channel.radios[0].send(STEP_US, [Broadcast(seq=0, at_us=STEP_US, payload=b"hello")])
    assert channel.advance(STEP_US).delivered == (1,)
    assert channel.received(1, 3 * STEP_US - 1) == []
    (item,) = channel.received(1, 3 * STEP_US)
    assert item.payload == b"hello"
    assert STEP_US * 1_000 < item.received_ns < 2 * STEP_US * 1_000
    assert channel.received(1, 10 * STEP_US) == []
    assert channel.received(0, 10 * STEP_US) == []


def test_a_batch_of_a_later_step_waits_for_the_interval_of_that_step():
    channel = Channel()
    channel.radios[0].send(2 * STEP_US, [Broadcast(seq=0, at_us=2 * STEP_US, payload=b"later")])
    channel.advance(STEP_US)
    assert channel.received(1, 10**9) == []
    channel.advance(2 * STEP_US)
    assert len(channel.received(1, 10**9)) == 1


def test_a_frame_after_minutes_of_silence_is_delivered():
    """No frames for two minutes, in intervals of one second, during which the channel is quiet."""
    channel, second_us = Channel(), 1_000_000
    client = EmulatorClient(channel.line, period_us=second_us)
    truth = SimpleNamespace(
        pos_ned_m=np.array([[0.0, 0.0, -10.0], [10.0, 0.0, -10.0]]),
        vel_ned_m_s=np.zeros((2, 3)),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
    )
    for time_us in range(0, 120 * second_us, second_us):
        client.begin(time_us, STEP_US, truth, **RADIO)
        client.end()
    now_us = 120 * second_us
    channel.radios[0].send(now_us, [Broadcast(seq=0, at_us=now_us, payload=b"again")])
    client.begin(now_us, STEP_US, truth, senders=(0,), **RADIO)
    assert client.end() == ()
    assert client.delivered(now_us + second_us) == (1,)
    assert [item.payload for item in channel.received(1, now_us + second_us)] == [b"again"]


def test_invalid_positions_and_times_are_refused():
    channel = Channel()
    with pytest.raises(ValueError, match="rejects the request to advance"):
        channel.advance(STEP_US, pos_ned_m=pack_rows(np.full((2, 3), np.nan)))
    far_us = 10**9
    with pytest.raises(ValueError, match="refuses"):
        channel.radios[0].send(far_us, [Broadcast(seq=0, at_us=far_us, payload=b"")])


def test_kernels_that_were_imported_before_are_loaded_from_the_runs_cache(tmp_path):
    """Numba fixes a kernel's cache at import, here beside the sources, where it might be stale."""
    program = (
        "import harness.world.physics.rotors as rotors, autopilot.control.attitude, sys\n"
        "from numba.core.dispatcher import Dispatcher\n"
        "from harness.launch import kernel_cache\n"
        "from foundation.kernels.use_cache import use_kernel_cache\n"
        "def caches():\n"
        "    return {value._cache.cache_path for name, module in sys.modules.items()\n"
        "            if name.partition('.')[0] in kernel_cache.PACKAGES\n"
        "            for value in vars(module).values() if isinstance(value, Dispatcher)}\n"
        "folder = str(kernel_cache.folder())\n"
        "before = caches()\n"
        "assert before and not any(path.startswith(folder) for path in before), before\n"
        "use_kernel_cache()\n"
        "assert all(path.startswith(folder) for path in caches()), caches()\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != kernel_cache.VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()

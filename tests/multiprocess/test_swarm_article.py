"""The article's scenario with all processes: eight vehicles, radio, antenna, files of the run folder."""

import json
import shutil
import subprocess
from collections import Counter

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from harness.launch import kernel_cache
from harness.launch.swarm import Swarm
from harness.simulator.messages import Collision, Formed, VehicleLost

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
HOLD_S = 8.0


@pytest.fixture(scope="module")
def own_kernels(tmp_path_factory):
    """Copy the compiled kernels for this swarm, since parallel tests compile for other types."""
    shared = kernel_cache.folder()
    own = tmp_path_factory.mktemp("kernels") / shared.name
    shutil.copytree(shared, own, ignore=shutil.ignore_patterns("*.tmp.*"))  # incomplete files
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(kernel_cache.VARIABLE, str(own))
        kernel_cache.folder.cache_clear()
        yield own
    kernel_cache.folder.cache_clear()


@pytest.fixture(scope="module")
def flown(tmp_path_factory, own_kernels):
    """Fly once for all tests; returns summary, folder, and observations in flight."""
    folder = tmp_path_factory.mktemp("article") / "run"
    with Swarm(ARTICLE, out=folder, overrides=["radio.capture=true"], wall_limit_s=280.0) as swarm:
        kernels = set(own_kernels.rglob("*.nb?"))
        swarm.run_until_formed(timeout_s=60.0)
        names = {name: psutil.Process(pid).name() for name, pid in swarm.pids.items()}
        pids = swarm.pids
        swarm.run_for(HOLD_S)
        uss_mb = {name: psutil.Process(pid).memory_full_info().uss * 1e-6 for name, pid in swarm.pids.items()}
        swarm.stop()
        summary = swarm.summary()
        compiled = set(own_kernels.rglob("*.nb?")) - kernels
        return {
            "summary": summary,
            "folder": folder,
            "pids": pids,
            "names": names,
            "uss_mb": uss_mb,
            "events": swarm.events,
            "forced": swarm.forced,
            "leftovers": swarm.leftovers(),
            "kernels": kernels,
            "compiled": compiled,
        }


def test_autopilots_and_emulator_are_separate_processes(flown):
    manifest = json.loads((flown["folder"] / "manifest.json").read_text())
    listed = {process["name"]: process["pid"] for process in manifest["processes"]}
    assert listed == flown["pids"]
    forked = {"prefork", *(f"uav {i}" for i in range(8))}
    assert set(listed) == {"physics", "radio"} | forked
    assert len(set(listed.values())) == 11
    assert {name: flown["names"][name] for name in forked} == {name: name for name in forked}
    assert all(process["ending"].endswith("ended with status 0") for process in manifest["processes"])


def test_unique_memory_of_a_vehicle_is_small(flown):
    assert max(flown["uss_mb"][f"uav {i}"] for i in range(8)) < 60.0


def test_formation_is_reached_without_collision_and_no_process_is_left(flown):
    kinds = [type(event) for event in flown["events"]]
    assert kinds.count(Formed) == 1
    assert Collision not in kinds
    assert VehicleLost not in kinds
    assert flown["forced"] == ()
    assert flown["leftovers"] == []


def test_summary_has_the_results_of_the_flight(flown):
    summary = flown["summary"]
    assert summary == json.loads((flown["folder"] / "summary.json").read_text())
    assert summary["status"] == "completed"
    assert summary["agents"] == 8
    assert summary["formation_s"] == pytest.approx(HOLD_S, abs=0.1)
    assert summary["real_time_factor"] == pytest.approx(summary["simulated_s"] / summary["wall_s"], rel=1e-3)
    assert summary["collisions"] == 0
    assert summary["deterministic"] is True
    # the shape error is a fraction of the GPS error: distances were measured over the channel
    assert 0.0 < summary["formation_rms_m"]["shape"] < 0.4
    assert summary["formation_rms_m"]["shape"] < summary["formation_rms_m"]["absolute"] < 3.0
    assert [vehicle["uav"] for vehicle in summary["vehicles"]] == list(range(8))
    assert all(vehicle["alive"] for vehicle in summary["vehicles"])
    frames = summary["frames"]
    assert frames["sent"] > 1000
    assert frames["delivered"] > frames["collided"] > 0
    assert 0.02 < summary["channel_busy_fraction"] < 0.15
    ftm = summary["ftm"]
    assert ftm["requested"] == ftm["completed"] + ftm["failed"]
    assert ftm["completed"] > 0.95 * ftm["requested"] > 0
    assert abs(ftm["error_mean_m"]) < 0.02
    assert ftm["error_std_m"] == pytest.approx(0.0808 / np.sqrt(7), rel=0.15)  # 80 MHz, seven round trips
    gain = summary["max_gain_dbi"]
    assert gain["ideal"] == pytest.approx(13.26, abs=0.01)
    assert gain["ideal"] - 1.0 < gain["mean"] < gain["ideal"] + 0.1
    assert len(summary["log_sha256"]) == 64


def test_tables_have_truth_and_estimates(flown):
    flight = pq.read_table(flown["folder"] / "flight.parquet").to_pydict()
    time_us = np.array(flight["time_us"]).reshape(-1, 8)
    assert (np.diff(time_us[:, 0]) == 40_000).all()
    hold = time_us[:, 0] > time_us[-1, 0] - int(HOLD_S * 1e6)
    positions = [
        np.stack([np.array(flight[f"{name}.{axis}"]).reshape(-1, 8)[hold] for axis in "ne"], axis=2)
        for name in ("pos_ned_m", "estimator_pos_ned_m", "onboard_pos_ned_m")
    ]
    # the applications' distances between vehicles are far better than the autopilots', which have GPS alone
    truth, autopilots, applications = (np.linalg.norm(p[:, :, None] - p[:, None], axis=3) for p in positions)
    assert np.std(applications - truth) < 0.2 * np.std(autopilots - truth)
    radio = pq.read_table(flown["folder"] / "radio.parquet")
    kinds = set(radio.column("kind").to_pylist())
    assert {"rts", "cts", "ack", "data"} < kinds
    assert radio.num_rows == flown["summary"]["frames"]["sent"]
    sessions = pq.read_table(flown["folder"] / "ftm.parquet").to_pydict()
    assert {(a, b) for a, b in zip(sessions["initiator"], sessions["peer"], strict=True)} == {
        (a, b) for a in range(8) for b in range(8) if a != b
    }


def test_all_figures_are_drawn(flown):
    names = {path.name for path in (flown["folder"] / "figures").iterdir()}
    expected = ("channel", "formation_error", "ftm_error", "gain_density", "patterns", "tracks")
    assert names == {f"{name}.{suffix}" for name in expected for suffix in ("png", "pdf")}
    assert not (flown["folder"] / "raw").exists()


def test_no_kernel_is_compiled_in_flight(flown):
    assert flown["compiled"] == set()
    assert flown["kernels"]  # the folder is the right one


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_wireshark_dissects_every_kind_of_frame(flown):
    command = ["tshark", "-n", "-r", str(flown["folder"] / "radio.pcapng"), "-d", "udp.port==50802,data"]
    malformed = subprocess.run(
        [*command, "-Y", "_ws.malformed || _ws.expert.severity >= 0x00600000"],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert malformed.stdout == ""
    listed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    kinds = Counter(
        next(
            name
            for name in ("Request-to-send", "Clear-to-send", "Acknowledgement", "FTM", "UDP")
            if name in line
        )
        for line in listed.stdout.splitlines()
    )
    sent = Counter(pq.read_table(flown["folder"] / "radio.parquet", columns=["kind"])["kind"].to_pylist())
    assert kinds == {
        "Request-to-send": sent["rts"],
        "Clear-to-send": sent["cts"],
        "Acknowledgement": sent["ack"],
        "FTM": sent["ftm"] + sent["ftm_request"],
        "UDP": sent["data"],
    }

"""The live view with the real Rerun: the same logs, on loopback only, and nothing is left."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from paths import SCENARIOS
from supervising import alive, wait_for
from view_pieces import line_of_vehicles
from without_privileges import obeying_modes

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.onboard.factory import layout_of
from foundation.records.record_log import count
from harness.launch.one_process import OneProcessSwarm, fly
from harness.launch.swarm import Swarm
from harness.records.run_folder import RunFolder
from harness.report.vehicle_colours import vehicle_colours
from harness.scenario.scenario_file import load
from harness.view.camera import overview
from harness.view.entries import colour_of

pytest.importorskip("rerun", reason="the extra coflight[view] is not installed")
from harness.view.rerun_sink import RerunSink
from harness.view.scene import Scene
from harness.view.viewer import LOOPBACK, Viewer

pytestmark = pytest.mark.multiprocess

SETTINGS = ("agents=2", "formation.columns=2", "formation.height_m=2", "run.duration_s=1")
CHROMIUM = Path("/usr/bin/chromium")
LIMIT_S = 120.0


def start(*arguments, folder):
    command = [
        sys.executable,
        "-m",
        "coflight",
        "fly",
        "article",
        *(f"--set={each}" for each in SETTINGS),
        "--json",
        *arguments,
    ]
    environment = {
        name: text for name, text in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")
    }
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def read_until(process, text):
    """Return the line on stderr that has a text."""
    for line in process.stderr:
        if text in line:
            return line
    raise AssertionError(f"ended without {text!r}")


def of_view(process):
    """Return the launcher's children that belong to the view, by the part of it."""
    found = {}
    for child in psutil.Process(process.pid).children(recursive=True):
        words = " ".join(child.cmdline())
        for part in ("rerun_cli", "harness.view.page_server", "harness.view.feed"):
            if part in words:
                found[part] = child
    return found


@pytest.fixture(scope="module")
def plain_hash(tmp_path_factory):
    """Return the hash of the same flight in one process and without a view."""
    return fly(load(SCENARIOS / "article.toml", SETTINGS), tmp_path_factory.mktemp("plain"))["log_sha256"]


def test_a_flight_whose_viewer_is_killed_ends_as_one_without(plain_hash, tmp_path):
    process = start("--view", "--record", "run.rrd", "--out", "run", folder=tmp_path)
    assert "no display" in read_until(process, "display")
    address = read_until(process, "open http")
    wait_for(lambda: len(of_view(process)) == 3, "the parts of the view")
    parts = of_view(process)
    listening = {
        name: [each.laddr for each in child.net_connections("inet") if each.status == psutil.CONN_LISTEN]
        for name, child in parts.items()
    }
    assert [len(listening[name]) for name in sorted(listening)] == [0, 1, 2]
    hosts = {host for addresses in listening.values() for host, _ in addresses}
    assert hosts == {LOOPBACK}
    assert address.split()[1].startswith(
        f"http://{LOOPBACK}:{listening['harness.view.page_server'][0].port}/"
    )
    parts["rerun_cli"].kill()
    output, messages = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, messages
    assert "the viewer was closed, or has ended; the flight goes on" in messages
    assert json.loads(output)["log_sha256"] == plain_hash
    assert not any(alive(child.pid) for child in parts.values())
    recording = tmp_path / "run.rrd"
    assert recording.stat().st_mode & 0o777 == 0o600
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(recording)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for entity in (
        "/world/uav-0",
        "/world/uav-1",
        "/world/links/delivered",
        "/states/uav-1/mode",
        "/log/formed",
    ):
        assert f"{entity}" in printed, entity


def test_a_recording_into_a_folder_without_permission_is_refused_before_the_flight(tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    command = [sys.executable, "-m", "coflight", "fly", "article", "--record", str(closed / "run.rrd")]
    done = subprocess.run(
        obeying_modes(*command), cwd=tmp_path, capture_output=True, text=True, check=False, timeout=LIMIT_S
    )
    assert done.returncode == 2
    assert "no permission" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "runs").exists()


def test_a_dead_feed_is_named_and_a_killed_launcher_leaves_nothing(tmp_path):
    process = start("--web", "--out", "run", folder=tmp_path)
    read_until(process, "open http")
    wait_for(lambda: len(of_view(process)) == 3, "the parts of the view")
    parts = of_view(process)
    parts["harness.view.feed"].kill()
    line = read_until(process, "the flight goes on")
    assert "SIGKILL" in line
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=LIMIT_S)
    wait_for(lambda: not any(alive(child.pid) for child in parts.values()), "the end of the view")


def test_live_records_of_a_killed_vehicle_are_those_of_a_run_without(tmp_path):
    """Each record is in the log at once; of a killed vehicle the tables have whole blocks, as otherwise."""
    hashes = []
    for kind, live in ((Swarm, True), (OneProcessSwarm, False)):
        with kind(
            load(SCENARIOS / "article.toml", SETTINGS), out=tmp_path / kind.__name__, live_records=live
        ) as swarm:
            truth = swarm.run(until_s=1.02)
            rows = count(RunFolder(swarm.path).raw_vehicle(1), VEHICLE_RECORD)
            assert rows == (25 if live else 0), truth.t_s
            swarm.kill(1)
            swarm.run(until_s=1.5)
        hashes.append(swarm.summary(draw=False)["log_sha256"])
    assert hashes[0] == hashes[1]


@pytest.mark.skipif(not CHROMIUM.exists(), reason="needs Chromium")
def test_the_web_viewer_shows_eight_vehicles(tmp_path):
    """The colours of eight vehicles are in the page, and the browser asks nothing of other machines."""
    sync_api = pytest.importorskip("playwright.sync_api")
    pil = pytest.importorskip("PIL.Image")
    scenario = load(SCENARIOS / "article.toml")
    colours = {*map(colour_of, vehicle_colours(scenario.agents))}
    assert len(colours) == scenario.agents == 8
    with Viewer(tmp_path / "viewer", in_browser=True) as viewer, sync_api.sync_playwright() as playwright:
        sink = RerunSink("test", url=viewer.url)
        scene = Scene(scenario, layout_of(scenario.onboard))
        sink.arrange(overview(scenario.places_ned_m()))
        sink.send(scene.static())
        sink.send(scene.entries(line_of_vehicles(scenario)))
        browser = playwright.chromium.launch(
            executable_path=str(CHROMIUM),
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": 1000, "height": 700})
        answered = []
        page.on("response", lambda response: answered.append(response.url))
        page.goto(viewer.address)
        missing, deadline_s = set(colours), time.monotonic() + LIMIT_S
        while missing and time.monotonic() < deadline_s:
            page.wait_for_timeout(500)
            page.screenshot(path=tmp_path / "page.png")
            with pil.open(tmp_path / "page.png") as picture:
                scene_part = picture.convert("RGB").crop((0, 40, 590, 500))
            shown = scene_part.getcolors(1_000_000)
            # the plots have these colours too; shading changes some of lines, bodies and names
            missing = {one for one in colours if not any(near(one, other) for _, other in shown)}
        browser.close()
        sink.close()
    assert not missing
    assert answered
    assert all(url.startswith((f"http://{LOOPBACK}:", "blob:", "data:")) for url in answered)


def near(first, second):
    return all(abs(a - b) <= 3 for a, b in zip(first, second, strict=True))

"""report.html of a run and of a campaign in a real Chromium, from disk and without a network. 20 s."""

import shutil
import stat

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from chromium import browser, file_page
from paths import SCENARIOS

from harness.campaign.page import write_page as write_campaign_page
from harness.launch.one_process import OneProcessSwarm
from harness.records.run_folder import RunFolder, read_scenario
from harness.report.page.html import render
from harness.report.page.run_sections import page_of, scenario_section
from harness.report.report import draw_again
from harness.scenario.scenario_file import load

HOSTILE = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>{{ 7 * 7 }}%{x}"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Fly three vehicles for some seconds; returns the run's folder."""
    settings = ["agents=3", "antenna.grid_deg=6", "run.reach_timeout_s=30"]
    out = tmp_path_factory.mktemp("page") / "run"
    with OneProcessSwarm(load(SCENARIOS / "article.toml", settings), out=out) as flown:
        flown.run(until_s=8.0)
        flown.summary()
    return RunFolder(out)


@pytest.fixture(scope="module")
def chromium():
    with browser() as started:
        yield started


def test_page_of_a_run_is_private_whole_and_no_part_of_the_hash(run):
    assert stat.S_IMODE(run.page.stat().st_mode) == 0o600
    assert not list(run.path.glob(".report*"))
    assert run.page.name not in msgspec.json.decode(run.manifest.read_bytes())["logs_sha256"]
    assert run.page.stat().st_size < 8_000_000


def test_page_drawn_again_from_the_tables_has_the_same_bytes(run):
    before = run.page.read_bytes()
    scenario = read_scenario(run)
    summary = msgspec.json.decode(run.summary.read_bytes())
    formed_us = None if summary["formed_s"] is None else round(summary["formed_s"] * 1e6)
    draw_again(run, scenario, formed_us=formed_us)
    assert run.page.read_bytes() == before


@pytest.fixture(scope="module")
def wide(run, chromium):
    """Open the page of the run once: its scene takes some 4 s with software rendering."""
    with file_page(chromium) as opened:
        opened.open(run.page)
        yield opened


def test_run_has_all_figures_without_errors_network_or_sideways_scrolling(wide):
    assert wide.draw_all() >= 15
    assert wide.errors == []
    assert wide.foreign_requests() == []
    assert wide.page.evaluate("document.documentElement.scrollWidth") <= 1280
    text = wide.page.inner_text("main")
    for part in ("Formation reached at", "Ranging sessions", "reach_timeout_s", "Hash of the logs"):
        assert part in text


def test_slider_moves_vehicles_and_links(run, wide):
    page = wide.page
    positions = "document.getElementById('replay').data.find((each) => each.name === 'UAV').z"
    page.locator("#replay").scroll_into_view_if_needed()
    page.locator("#replay .main-svg").first.wait_for(state="attached")
    slider = page.locator("#replay-time")
    found = []
    for instant in ("0", slider.get_attribute("max")):
        slider.fill(instant)
        found.append((page.evaluate(positions), page.inner_text("#replay-clock")))
    (z_first, at_first), (z_last, at_last) = found
    time_us = pq.read_table(run.flight, columns=["time_us"])["time_us"].to_pylist()
    assert (at_first, at_last) == (f"t = {time_us[0] / 1e6:.2f} s", f"t = {time_us[-1] / 1e6:.2f} s")
    assert len(z_first) == len(z_last) == 3
    truth = pq.read_table(run.flight, columns=["pos_ned_m.d"])["pos_ned_m.d"].to_pylist()
    assert z_first == pytest.approx([-each for each in truth[:3]], abs=1e-5)
    assert z_last == pytest.approx([-each for each in truth[-3:]], abs=1e-5)
    page.locator("#chips button[data-uav='1']").click()
    assert len(page.evaluate(positions)) == 2
    assert wide.errors == []


def test_click_on_a_bar_sets_the_replay_to_the_time_there(run, wide):
    end_s = msgspec.json.decode(run.summary.read_bytes())["simulated_s"]
    bars = wide.page.locator("#plot-timeline .nsewdrag")
    bars.scroll_into_view_if_needed()
    size = bars.bounding_box()
    row = size["height"] * 1.6 / 4.2  # of the rows from -1.6 to 2.6, the bars of phases at 0
    at = {"x": 0.5 * size["width"], "y": row}
    bars.hover(position=at)
    bars.click(position=at)
    found_s = float(wide.page.inner_text("#replay-clock").removeprefix("t = ").removesuffix(" s"))
    assert found_s == pytest.approx(0.5 * end_s, abs=0.2)  # an instant and a dot


def test_page_follows_to_a_narrow_dark_screen(wide):
    colours = (
        "[getComputedStyle(document.documentElement).getPropertyValue('--text').trim(),"
        " ...[...document.querySelectorAll('.graph')].map((each) => each._fullLayout.font.color)]"
    )
    light, *_ = wide.page.evaluate(colours)
    wide.page.set_viewport_size({"width": 420, "height": 900})
    wide.page.emulate_media(color_scheme="dark")
    wide.wait_until(f"new Set({colours}).size === 1")
    wide.wait_until("document.documentElement.scrollWidth <= 420")
    assert wide.page.evaluate(colours)[0] != light
    assert wide.errors == []


def test_names_of_strangers_stay_text(run, chromium, tmp_path):
    scenario = read_scenario(run)
    summary = msgspec.json.decode(run.summary.read_bytes()) | {"reason": HOSTILE}
    manifest = msgspec.json.decode(run.manifest.read_bytes())
    manifest |= {"nondeterminism": [HOSTILE], "command": [HOSTILE], "versions": {HOSTILE: HOSTILE}}
    page = page_of(scenario, summary, manifest, [scenario_section(scenario)], colours=["#123456"])
    path = tmp_path / "report.html"
    path.write_bytes(render(page))
    with file_page(chromium) as opened:
        opened.open(path)
        assert opened.page.evaluate("window.hacked") is None
        assert opened.page.locator(".warning").first.inner_text() == HOSTILE
        assert opened.page.locator("img").count() == 0
        assert opened.errors == []


def test_hostile_campaign_stays_text_and_names_failed_runs(chromium, tmp_path):
    digest = "0123456789abcdef"
    rows = [
        {
            "case": case, "seed": seed, "status": "failed" if (case, seed) == ("b", 2) else "completed",
            "reason": HOSTILE if (case, seed) == ("b", 2) else None, "digest": f"{digest}{case == 'b'}{seed}",
            "formation_rms_m.shape": None if (case, seed) == ("b", 2) else 0.1 * seed, "vehicles_lost": 0,
        }
        for case in (HOSTILE, "b") for seed in (1, 2, 3)
    ]  # fmt: skip
    about = {"campaign": HOSTILE, "scenario": "article"}
    table = pa.Table.from_pylist(rows).replace_schema_metadata(about)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / f"{digest}False1.json").write_text("{}", encoding="utf-8")
    pq.write_table(table, tmp_path / "table.parquet")
    write_campaign_page(tmp_path / "table.parquet")
    assert stat.S_IMODE((tmp_path / "report.html").stat().st_mode) == 0o600
    with file_page(chromium) as opened:
        opened.open(tmp_path / "report.html")
        assert opened.draw_all() == 1
        assert opened.page.evaluate("window.hacked") is None
        assert opened.page.inner_text("h1").startswith(HOSTILE)
        assert HOSTILE in opened.page.inner_text("#failed")
        assert opened.page.locator("#runs a").get_attribute("href") == f"runs/{digest}False1.json"
        assert "<script>" in opened.page.inner_text("#plot-factor-0-0")
        mean, interval = opened.page.evaluate(
            "(() => { const t = document.getElementById('plot-factor-0-0').data[0];"
            " return [t.y, t.error_y.array]; })()"
        )
        assert mean == pytest.approx([0.2, 0.2])
        assert interval == pytest.approx([4.302653 * 0.1 / 3**0.5, 12.706205 * 0.141421 / 2**0.5], rel=1e-4)
        assert opened.errors == []


def test_page_without_a_recorded_instant_is_written(run, chromium, tmp_path):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(run.path, folder.path)
    for path in (folder.flight, folder.radio, folder.ftm, folder.air):
        pq.write_table(pq.read_table(path).slice(0, 0), path)
    draw_again(folder, read_scenario(folder), formed_us=None)
    with file_page(chromium) as opened:
        opened.open(folder.page)
        opened.draw_all()
        assert opened.errors == []
        assert "No frame was sent." in opened.page.inner_text("#channel")

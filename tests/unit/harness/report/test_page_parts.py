"""Parts of report.html: envelopes, packed data, segments, links, changes of a scenario. 2 s."""

import base64
import json
import math
import os

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.records.run_folder import RunFolder
from harness.records.table_reader import TableReader
from harness.report.page import replay
from harness.report.page.channel_plots import ChannelStatistics
from harness.report.page.content import Link, file_link
from harness.report.page.encoding import packed, plot_text, script_json
from harness.report.page.envelope import envelope
from harness.report.page.flight_plots import sensor_plots
from harness.report.page.ranging_plots import RangingStatistics
from harness.report.page.replay import Links, replay_rows
from harness.report.page.run_tables import recorded_s
from harness.report.page.scenario_changes import changes
from harness.report.page.timeline import MOST_BARS, MOST_EVENTS, event_rows, segments, shown_events
from harness.scenario.scenario import RunConfig, Scenario


@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=400), st.integers(1, 40))
def test_envelope_has_the_extremes_and_at_most_two_points_a_bin(values, bins):
    series = np.array(values)[:, np.newaxis]
    found = envelope(series, bins=bins)
    assert len(found.rows) == len(found.values) <= 2 * bins
    assert np.all(np.diff(found.rows) >= 0)
    assert found.values.max() == np.float32(series.max())
    assert found.values.min() == np.float32(series.min())


def test_envelope_follows_a_fall_and_keeps_gaps():
    falling = np.linspace(9.0, 0.0, 100)[:, np.newaxis]
    assert np.all(np.diff(envelope(falling, bins=10).values[:, 0]) < 0)
    gap = falling.copy()
    gap[50:] = np.nan
    found = envelope(gap, bins=10).values[:, 0]
    assert np.isfinite(found[:10]).all()
    assert np.isnan(found[10:]).all()


@given(st.text())
def test_json_in_a_script_keeps_texts_and_cannot_leave_it(text):
    written = script_json({"text": text, "number": math.nan})
    assert not set("<>&\u2028\u2029") & set(written)
    assert json.loads(written) == {"text": text, "number": None}


def test_texts_of_figures_are_not_markup_and_no_format():
    assert plot_text("<b>%{x}</b> & more") == "&lt;b&gt;% {x}&lt;/b&gt; &amp; more"


def test_packed_arrays_state_type_and_shape():
    content = packed(np.array([[1, 2], [3, 4]], np.uint8))
    assert content["shape"] == "2, 2"
    assert list(base64.b64decode(content["bdata"])) == [1, 2, 3, 4]
    with pytest.raises(KeyError):
        packed(np.zeros(1, np.int64))


def test_segments_are_the_times_of_constant_values_and_end_with_the_vehicle():
    time_s = np.arange(6.0)
    values = np.array([[1, 7], [1, 7], [2, 7], [2, 7], [2, 7], [1, 7]])
    alive = np.ones((6, 2), np.bool_)
    alive[3:, 1] = False
    found = [(each.vehicle, each.value, each.start_s, each.end_s) for each in segments(time_s, values, alive)]
    assert found == [(0, 1, 0.0, 2.0), (0, 2, 2.0, 5.0), (0, 1, 5.0, 5.0), (1, 7, 0.0, 3.0)]


def test_values_that_alternate_give_a_bounded_number_of_segments():
    values = np.tile([0, 1, 2], 20_000)[:, np.newaxis]
    found = segments(np.arange(60_000.0), values, np.ones(values.shape, np.bool_))
    assert len(found) <= MOST_BARS
    assert (found[0].start_s, found[-1].end_s) == (0.0, 59_999.0)


def test_unknown_events_are_listed_by_their_fields():
    (row,) = event_rows([{"event": "news", "time_us": 1_500_000, "instance": 2, "what": "x"}])
    assert (row.time_s, row.vehicle, row.text, row.is_bad) == (1.5, 2, "News what = x", False)


def test_failures_are_shown_also_after_many_texts():
    texts = [{"event": "applicationtext", "time_us": k, "instance": 0, "text": "x"} for k in range(700)]
    lost = {"event": "vehiclelost", "time_us": 900, "instance": 3, "reason": "r"}
    shown = shown_events(event_rows([*texts, lost]))
    assert len(shown) == MOST_EVENTS
    assert shown[-1].text == "Lost: r"
    assert [each.time_s * 1e6 for each in shown[:-1]] == pytest.approx(list(range(MOST_EVENTS - 1)))


def test_link_to_a_file_whose_name_is_not_utf8_leads_to_its_bytes():
    link = file_link(os.fsdecode(b"logs/\xff<b> #.log"))
    assert link == Link("logs/\N{REPLACEMENT CHARACTER}<b> #.log", "logs/%FF%3Cb%3E%20%23.log")


def test_names_of_sensors_are_escaped_in_figures_and_plain_over_them():
    series = {("A & B", "<i>_m"): np.zeros((4, 1), np.float32)}
    (plot,) = sensor_plots(series, np.array([0.0, 1.0, 2.0]), left_out=0)
    assert plot.title == "A & B: <i>_m"
    assert plot.layout["yaxis"]["title"]["text"].startswith("&lt;i&gt;_m")


@pytest.mark.parametrize(("duration_s", "vehicles"), [(60.0, 8), (3600.0, 8), (60.0, 64), (36000.0, 254)])
def test_replays_are_bounded_and_reach_the_end(duration_s, vehicles):
    time_s = np.arange(0.0, duration_s, 0.04)
    rows, rate_hz = replay_rows(time_s, vehicles)
    assert rows[0] == 0
    assert rows[-1] == len(time_s) - 1
    assert 2 <= len(rows) <= 1_501
    assert len(rows) * vehicles <= 60_000 + 2 * vehicles
    assert np.diff(time_s[rows])[:-1] == pytest.approx(1.0 / rate_hz, abs=0.041)


def _unpacked(content, kind):
    return np.frombuffer(base64.b64decode(content["bdata"]), kind).tolist()


def test_links_are_those_since_the_instant_before_and_failed_if_one_failed():
    links = Links(np.array([0.0, 1.0, 2.0]), vehicles=3)
    sessions = {
        "measured_ns": np.array([500, 900, 1000, 1100, 5000]) * 1_000_000,
        "initiator": np.array([0, 1, 2, 2, 0]), "peer": np.array([1, 0, 3, 1, 1]),
        "status": np.array([0, 1, 0, 0, 0]),
    }  # fmt: skip
    links.add_sessions(sessions, ["ok", "timeout"])  # of a guest (3) and after the end: without a link
    content = links.content()
    assert _unpacked(content["starts"], np.int32) == [0, 0, 1, 2]
    pairs = [_unpacked(content[key], np.uint8) for key in ("first", "second", "state")]
    assert pairs == [[0, 1], [1, 2], [1, 0]]


@pytest.mark.parametrize("merged_at", [1, 10**6])
def test_links_in_batches_are_those_of_all_rows_and_stay_bounded(monkeypatch, merged_at):
    rng = np.random.default_rng(5)
    count, ends_s = 4_000, np.arange(1.0, 41.0)
    sessions = {
        "measured_ns": np.sort(rng.integers(0, 40 * 10**9, count)), "initiator": rng.integers(0, 5, count),
        "peer": rng.integers(0, 5, count), "status": (rng.random(count) < 0.2).astype(int),
    }  # fmt: skip
    expected: dict[tuple[int, int, int], int] = {}
    for time_ns, *pair, status in zip(*(values.tolist() for values in sessions.values()), strict=True):
        key = (int(np.searchsorted(ends_s, time_ns / 1e9)), min(pair), max(pair))
        expected[key] = max(expected.get(key, 0), status)

    def found(most):
        monkeypatch.setattr(replay, "MOST_LINKS", most)
        monkeypatch.setattr(replay, "MERGED_AT", merged_at)
        links = Links(ends_s, vehicles=5)
        for first in range(0, count, 128):
            links.add_sessions(
                {name: values[first : first + 128] for name, values in sessions.items()}, ["ok", "timeout"]
            )
        content = links.content()
        instants = np.repeat(np.arange(40), np.diff(_unpacked(content["starts"], np.int32)))
        first, second, state = (_unpacked(content[key], np.uint8) for key in ("first", "second", "state"))
        rows = zip(instants.tolist(), first, second, strict=True)
        return list(zip(rows, state, strict=True)), links.until_s()

    whole = sorted(expected.items())
    assert found(10_000) == (whole, None)
    cut, until_s = found(100)
    assert cut == whole[:100]
    assert until_s == ends_s[whole[100][0][0] - 1]


def test_halos_are_shares_of_lost_broadcasts():
    links = Links(np.array([1.0]), vehicles=2)
    frames = {
        "end_ns": np.array([1, 2, 3]), "source": np.array([0, 0, 1]), "destination": np.array([-1, -1, 0]),
        "kind": np.array([0, 0, 0]), "delivered": np.array([3, 0, 0]), "collided": np.array([0, 1, 1]),
        "lost_to_noise": np.zeros(3, int),
    }  # fmt: skip
    links.add_frames(frames, ["data"])
    content = links.content()
    assert _unpacked(content["lost"], np.uint8) == [64, 0]  # a quarter of 255, rounded up; unicasts not
    assert _unpacked(content["state"], np.uint8) == [3]


def test_statistics_in_batches_are_those_of_all_rows():
    rng = np.random.default_rng(3)
    count = 500
    frames = {
        "start_ns": np.sort(rng.integers(0, 10**10, count)), "source": rng.integers(0, 3, count),
        "kind": rng.integers(0, 2, count), "mode": rng.integers(0, 2, count),
        "bytes": rng.integers(10, 90, count), "delivered": rng.integers(0, 3, count),
        "collided": rng.integers(0, 2, count), "lost_to_noise": rng.integers(0, 2, count),
    }  # fmt: skip
    frames["end_ns"] = frames["start_ns"] + 1_000
    texts = {"kind": ["data", "ack"], "mode": ["a", "b"]}
    whole, parts = ChannelStatistics(10.0), ChannelStatistics(10.0)
    whole.add(frames, texts)
    for first in range(0, count, 64):
        parts.add({name: values[first : first + 64] for name, values in frames.items()}, texts)
    for one, other in zip(whole.table(whole.by_source), parts.table(parts.by_source), strict=True):
        assert one == pytest.approx(other)
    assert sum(each["frames"] for each in whole.table(whole.by_kind)) == count
    assert (whole.outcomes_over_time == parts.outcomes_over_time).all()
    assert whole.outcomes_over_time[:, 0].sum() == frames["delivered"].sum()


def test_ranging_statistics_are_those_of_numpy():
    error_m = np.array([0.1, -0.2, 0.4, 0.0])
    sessions = {
        "measured_ns": np.arange(4) * 10**9, "initiator": np.zeros(4, int), "peer": np.ones(4, int),
        "status": np.array([0, 0, 0, 1]), "distance_m": 10.0 + error_m, "true_distance_m": np.full(4, 10.0),
    }  # fmt: skip
    found = RangingStatistics(4.0)
    found.add(sessions, {"status": ["ok", "timeout"]})
    ((*pair, mean, spread),) = found.pair_rows()
    assert pair == [0, 1, 4, 3]
    assert (mean, spread) == pytest.approx((error_m[:3].mean(), error_m[:3].std(ddof=1)))
    assert found.by_status == {"ok": 3, "timeout": 1}


@pytest.mark.parametrize("duration_s", [50.0, 31.1, 0.05])
def test_errors_over_time_and_distance_have_the_first_and_the_last_session(duration_s):
    sessions = {
        "measured_ns": np.array([0.0, 0.5, 0.999, 1.0]) * duration_s * 1e9, "initiator": np.zeros(4, int),
        "peer": np.ones(4, int), "status": np.zeros(4, int),
        "true_distance_m": np.array([1.0, 2.0, 3.0, 9.0]), "distance_m": np.array([4.0, 2.0, 3.0, 16.0]),
    }  # fmt: skip
    found = RangingStatistics(duration_s)
    found.add(sessions, {"status": ["ok"]})
    plots = {plot.key: plot for plot in found.plots()}
    for key in ("ranging-over-time", "ranging-over-distance"):
        low, high = (np.float32(_unpacked(plots[key].data[k]["y"], np.float32)) for k in (1, 0))
        assert high[-1] > 3.0
        if len(high) > 1:
            assert (low[0], high[0]) == (3.0, 3.0)


def test_figures_of_a_killed_run_reach_its_last_frame(tmp_path):
    folder = RunFolder(tmp_path)
    for last_s, expected_s in ((5.93, 5.93), (5.15, 5.12), (1.0, 5.12)):
        pq.write_table(pa.table({"start_ns": [0, int(last_s * 1e9)]}), folder.radio)
        assert recorded_s(folder, 5.12) == pytest.approx(expected_s)


def test_table_reader_gives_the_values_of_arrow(tmp_path):
    table = pa.table({
        "flag": [True, False, True] * 5, "text": pa.array(["b", "a", "b"] * 5).dictionary_encode(),
        "single": pa.array([1.5, 2.5, math.nan] * 5, pa.float32()), "whole": pa.array(range(15), pa.uint8()),
    })  # fmt: skip
    pq.write_table(table, tmp_path / "t.parquet", row_group_size=4)
    reader = TableReader(tmp_path / "t.parquet")
    parts = list(reader.batches(reader.names, rows=4))
    found = {name: np.concatenate([part[name] for part in parts]).tolist() for name in reader.names}
    found["text"] = [reader.texts["text"][code] for code in found["text"]]
    assert repr(found) == repr(table.to_pydict())
    assert reader.column("whole").tolist() == list(range(15))


def test_table_reader_uses_a_pool_of_its_own_and_leaves_that_of_the_process(tmp_path):
    pq.write_table(pa.table({"value": np.arange(100_000.0)}), tmp_path / "t.parquet")
    process, system = pa.default_memory_pool(), pa.system_memory_pool()
    reader = TableReader(tmp_path / "t.parquet")
    before = system.bytes_allocated()
    batches = reader.batches(["value"])
    part = next(batches)
    assert pa.default_memory_pool().backend_name == process.backend_name
    assert system.bytes_allocated() - before >= part["value"].nbytes
    reader.close()


def test_changes_of_a_scenario_are_the_fields_that_differ():
    run = RunConfig(seed=9)
    (change,) = changes(Scenario(name="x", run=run))
    assert (change.path, change.value, change.default) == ("run.seed", "9", "1")
    assert change.description == "Seed of all random streams of the run."
    assert not list(changes(Scenario(name="other")))
    with_fault = msgspec.convert(
        {
            "name": "x",
            "faults": [{"kind": "motor", "uav": 0, "motor": 1, "effectiveness": 0.5, "start_s": 2.0}],
        },
        Scenario,
    )
    assert [each.path for each in changes(with_fault)] == ["faults"]

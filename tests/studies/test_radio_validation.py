"""Tests of the radio's validation: verdicts on given values, references, command lines, benchmark (20 s)."""

import json
import math
import pickle
import shlex
import sys

import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

from autopilot.onboard.radio.beacon import HEADER_BYTES, RANGE_BYTES
from foundation.exit_status import BAD_INPUT, FINE
from harness.scenario.scenario_file import load
from netsim.lab.broadcast import BroadcastResult
from netsim.lab.ranging import FtmResultSummary, MeshResult
from netsim.lab.saturation import SaturationResult
from netsim.model.event_queue import EventQueue
from netsim.phy.frames import DATA_OVERHEAD_BYTES, UDP_OVERHEAD_BYTES
from netsim.phy.modes import phy_mode, response_mode
from netsim.wire.messages import Broadcast, FtmRequest
from studies.common.report import draw_figures
from studies.radio import broadcast_section, error_section, mesh_section, ranging_section, saturation_section
from studies.radio.article_traffic import record
from studies.radio.bench import _play_empty, _scheduling, bench_saturated, play
from studies.radio.bench_cli import ARTICLE, bench_radio_app
from studies.radio.cli import SUBJECTS, VALIDATION, validate_radio_app
from studies.radio.peers import (
    BIANCHI_PACKET_BYTES,
    BIANCHI_UDP_BYTES,
    bianchi,
    ns3_broadcasts,
    ns3_error_curves,
    ns3_saturation,
)
from studies.radio.plan import QUICK_RADIO, RadioPlan
from studies.radio.statistics import crossing_db, mean_of

PLAN = RadioPlan(seeds=1, phase_seeds=1)


def missed(section):
    return [check.name for check in section.checks if not check.passed]


# ---- arithmetic


def test_crossing_is_interpolated_in_the_logarithm():
    """10^(5 - s) is linear in the logarithm and reaches 0.1 at s = 6, for any points."""
    snr_db = [4.7, 5.3, 5.8, 6.6, 7.0]
    per = [min(1.0, 10.0 ** (5.0 - s)) for s in snr_db]
    assert crossing_db(snr_db, per) == pytest.approx(6.0)
    assert crossing_db([1.0, 2.0], [0.1 + 1e-12, 0.0]) == 2.0
    assert math.isnan(crossing_db([1.0, 2.0], [0.9, 0.2]))
    assert math.isnan(crossing_db([1.0, 2.0], [0.05, 0.01]))


def test_means_have_the_standard_error_of_their_runs():
    """1, 2, 3: variance 1, so the mean's error is 1 / sqrt(3); a single run has none."""
    mean = mean_of([1.0, 2.0, 3.0])
    assert mean.value == pytest.approx(2.0)
    assert mean.error == pytest.approx(1.0 / math.sqrt(3.0))
    assert mean.text(2) == "2.00 ± 0.58"
    assert mean_of([4.0]).text(1) == "4.0"
    assert mean_of([None, 4.0]) == mean_of([4.0])
    assert math.isnan(mean_of([None]).value)


# ---- references


def bianchi_mbps(stations, frame_bytes):
    """Bianchi's model for 802.11a at 6 Mbit/s: W = 16, six doublings, DIFS after a collision.

    A backoff that is drawn as 0 after a success lets the same station send again at once, which is taken in
    by dividing payload and duration of a success by 1 - 1 / W.
    """
    mode, window, doublings = phy_mode("ofdm6", 20), 16, 6

    def attempt(p):
        return 2.0 * (1 - 2 * p) / ((1 - 2 * p) * (window + 1) + p * window * (1 - (2 * p) ** doublings))

    p = brentq(lambda p: p - 1.0 + (1.0 - attempt(p)) ** (stations - 1), 1e-6, 0.9)
    tau = attempt(p)
    busy = 1.0 - (1.0 - tau) ** stations
    good = stations * tau * (1.0 - tau) ** (stations - 1)
    slot_us, sifs_us, difs_us = 9.0, 16.0, 34.0
    data_us, ack_us = (
        1e-3 * each for each in (mode.duration_ns(frame_bytes), response_mode(mode).duration_ns(14))
    )
    success_us = (data_us + sifs_us + ack_us + difs_us) / (1.0 - 1.0 / window) + slot_us
    collision_us = data_us + difs_us + slot_us
    mean_us = (1.0 - busy) * slot_us + good * success_us + (busy - good) * collision_us
    return good * 8.0 * BIANCHI_PACKET_BYTES / (1.0 - 1.0 / window) / mean_us


def test_reference_packets_have_1500_bytes_over_llc_only():
    """With that frame the model is within 0.3 % of every value; IP and UDP headers would take 1.3 % more."""
    frame_bytes = BIANCHI_UDP_BYTES + UDP_OVERHEAD_BYTES + DATA_OVERHEAD_BYTES
    assert frame_bytes == 1500 + 8 + 28
    rows = [row for row in bianchi() if row.rate_mbps == 6]
    assert len(rows) == 8
    for row in rows:
        assert bianchi_mbps(row.stations, frame_bytes) == pytest.approx(row.throughput_mbps, rel=0.003)
        assert bianchi_mbps(row.stations, frame_bytes + 28) < 0.99 * row.throughput_mbps


def test_ns3_runs_have_as_many_ticks_as_ours():
    """All stations are in range, so either all of them receive a broadcast or none does.

    The delivery ratio is therefore a whole number of the datagrams sent in 600 ticks, to the table's six
    digits; with other run lengths this fails for some row.
    """
    rows = [row for row in ns3_broadcasts() if row.period_s == 0.1]
    assert len(rows) == 35

    def off(ticks):
        sent = [row.delivery_ratio * row.stations * ticks for row in rows]
        return max(abs(each - round(each)) for each in sent)

    assert {row.seconds for row in rows} == {60.0}
    assert off(600) < 0.05
    assert min(off(200), off(300), off(500)) > 0.2


# ---- judgements


def saturation_results(factor=lambda _row: 1.0):
    results = {}
    for name, rows in (("ns3", ns3_saturation()), ("bianchi", bianchi())):
        for row in rows:
            throughput_mbps = row.throughput_mbps * factor(row)
            if name == "bianchi":
                throughput_mbps *= BIANCHI_UDP_BYTES / BIANCHI_PACKET_BYTES
            results[f"{name}/{row.rate_mbps}/{row.rts}/{row.stations}"] = [
                SaturationResult(throughput_mbps=throughput_mbps, collisions_fraction=0.3, dropped=0)
            ]
    return results


def test_saturation_is_checked_row_by_row(tmp_path):
    results = saturation_results(lambda _row: 1.029)
    assert set(results) == set(saturation_section.jobs(PLAN))
    section = saturation_section.judge(PLAN, results)
    assert len(section.checks) == len(ns3_saturation()) + len(bianchi()) == 50
    assert missed(section) == []
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).stat().st_size > 10_000
    one_off = saturation_results(lambda row: 0.969 if (row.stations, row.rate_mbps) == (20, 24) else 1.0)
    assert missed(saturation_section.judge(PLAN, one_off)) == ["Bianchi, 24 Mbit/s, n = 20"]


def broadcast_results(ratio=0.0, delay=1.0):
    results = {}
    for row in ns3_broadcasts():
        reference, reference_ms = broadcast_section.theirs(row)
        # uses the tolerance added for the means' errors; a single run of ours has none
        lower = math.copysign(2.0 * (reference.error or 0.0), ratio) if ratio else 0.0
        later_ms = math.copysign(2.0 * (reference_ms.error or 0.0), delay - 1.0) if delay != 1.0 else 0.0
        results[f"{row.stations}/{row.period_s:g}/{row.jitter_s:g}"] = [
            BroadcastResult(
                delivery_ratio=max(reference.value + ratio + lower, 0.0),
                mean_delay_ms=delay * reference_ms.value + later_ms,
                p50_ms=1.0, p95_ms=2.0, p99_ms=3.0,
            )
        ]  # fmt: skip
    return results


def test_broadcasts_are_checked_by_delivery_and_delay(tmp_path):
    """At least 42 rows; delays only for rows with a delivery ratio above 0.05."""
    results = broadcast_results(ratio=-0.029, delay=1.09)
    assert set(results) == set(broadcast_section.jobs(PLAN))
    section = broadcast_section.judge(PLAN, results)
    assert missed(section) == []
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).stat().st_size > 10_000
    rows = ns3_broadcasts()
    delivered = [row for row in rows if row.delivery_ratio > 0.05]
    assert len(section.checks) == len(rows) + len(delivered)
    late = missed(broadcast_section.judge(PLAN, broadcast_results(delay=1.11)))
    assert len(late) == len(delivered)
    assert all(name.endswith("mean delay") for name in late)
    # below a delivery ratio of 0.031 there is no lower limit
    lost = missed(broadcast_section.judge(PLAN, broadcast_results(ratio=-0.031)))
    assert len(lost) == sum(row.delivery_ratio >= 0.031 for row in rows)


def test_phases_drawn_once_are_compared_with_several_seeds():
    """ns-3's seeds differ by more than the tolerance, so a single one cannot be the reference."""
    (row,) = (row for row in ns3_broadcasts() if (row.stations, row.period_s) == (8, 0.005))
    ratio, delay_ms = broadcast_section.theirs(row)
    assert ratio.error is not None
    assert abs(ratio.value - row.delivery_ratio) > 0.02
    assert delay_ms.value != row.mean_delay_ms
    (slow,) = (row for row in ns3_broadcasts() if (row.stations, row.jitter_s) == (8, 0.01))
    assert broadcast_section.theirs(slow)[0] == mean_of([slow.delivery_ratio])


def test_error_rates_are_checked_at_10_percent(tmp_path):
    """ns-3's curves pass; shifted by one point, 0.5 dB, non-HT fails; by two points all fail."""
    curves = ns3_error_curves()

    def moved(points):
        return {"curves": [(1.0,) * points + curve.per[: len(curve.per) - points] for curve in curves]}

    section = error_section.judge(PLAN, moved(0))
    assert missed(section) == []
    assert len(section.checks) == len(curves)
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).stat().st_size > 10_000
    non_ht = sum(curve.model == "nist" for curve in curves)
    assert 0 < non_ht < len(curves)
    assert len([name for name in missed(error_section.judge(PLAN, moved(1))) if "ofdm" in name]) == non_ht
    assert len(missed(error_section.judge(PLAN, moved(2)))) == len(curves)


def ranged(error_mean_m=0.7, error_std_m=0.1, round_trip_std_m=0.1, airtime_ms=1.5, failed=0):
    return FtmResultSummary(
        error_mean_m=error_mean_m,
        error_std_m=error_std_m,
        round_trip_std_m=round_trip_std_m,
        airtime_ms=airtime_ms,
        completed=100,
        failed=failed,
    )


def ranging_results(bias_m=0.0, trip=1.0, averaging=1.0, airtime=1.0, failed=0):
    """Make results; two frames result in one round trip, whose scatter follows from the other sessions."""
    trips_m = {20: 0.384 * trip, 40: 0.161 * trip, 80: 0.08 * trip}
    results = {
        f"width/{width}": [ranged(error_mean_m=0.7 + bias_m, round_trip_std_m=trip_m)]
        for width, trip_m in trips_m.items()
    }
    for width in (20, 80):
        results[f"frames/{width}"] = [
            ranged(
                error_std_m=averaging * trips_m[width] / math.sqrt(frames - 1),
                round_trip_std_m=trips_m[width] if frames > 2 else None,
            )
            for frames in ranging_section.FRAMES_PER_BURST
        ]
    results["airtime"] = [
        ranged(airtime_ms=airtime * airtime_ms, failed=failed)
        for *_, airtime_ms in ranging_section.AIRTIMES_MS
    ]
    return results


def test_ranging_is_checked_by_bias_sigma_averaging_and_air_time(tmp_path):
    results = ranging_results(bias_m=-0.0099, trip=1.09, averaging=0.91, airtime=1.049)
    assert set(results) == set(ranging_section.jobs(PLAN))
    section = ranging_section.judge(PLAN, results)
    assert missed(section) == []
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).stat().st_size > 10_000
    for wrong, text, count in (
        ({"bias_m": 0.0101}, "mean error", 3),
        ({"trip": 0.89}, "sigma of a round trip", 2),
        ({"averaging": 1.11}, "√", 12),
        ({"airtime": 0.949}, "air time", 3),
        ({"failed": 1}, "failed", 1),
    ):
        names = missed(ranging_section.judge(PLAN, ranging_results(**wrong)))
        assert len(names) == count
        assert all(text in name for name in names)


def mesh_results(plan, completed, delay_ms):
    """Make sessions of 1.5 ms; ``completed`` and ``delay_ms`` are functions of the requested air time."""
    results = {}
    for period_s in mesh_section.PERIODS_S:
        for n in range(2, plan.mesh_stations + 1):
            requested = 1.5e-3 * n * (n - 1) / period_s
            results[f"{period_s:g}/{n}"] = [
                MeshResult(
                    stations=n, completed_fraction=completed(requested), mean_delay_ms=delay_ms(requested),
                    round_trips_mean=7.0, busy_fraction=min(0.7 * requested, 0.7), airtime_fraction=requested,
                )
            ]  # fmt: skip
    return results


def test_ranging_of_all_pairs_is_checked_by_its_requested_air_time(tmp_path):
    def fits(requested):
        return min(1.0, 1.0 / requested)

    def delayed(requested):
        return 1.6 if requested < 1.0 else 10.0

    results = mesh_results(PLAN, fits, delayed)
    assert set(results) == set(mesh_section.jobs(PLAN))
    section = mesh_section.judge(PLAN, results)
    assert missed(section) == []
    draw_figures([section], tmp_path)
    assert (tmp_path / section.figures[0].file_name).stat().st_size > 10_000
    # a channel with unlimited capacity, and one with nearly none
    names = missed(mesh_section.judge(PLAN, mesh_results(PLAN, lambda _: 1.0, lambda _: 1.6)))
    assert len(names) == sum(check.name in names for check in section.checks) > 0
    assert {"round trips" in name or "delay" in name for name in names} == {True}
    names = missed(mesh_section.judge(PLAN, mesh_results(PLAN, lambda _: 0.1, delayed)))
    assert any("completed" in name for name in names)
    assert any("round trips" in name for name in names)


# ---- command lines


def test_subjects_have_picklable_jobs_and_a_quick_plan_has_fewer():
    assert set(VALIDATION.stages[0]) == set(SUBJECTS)
    for subject in SUBJECTS.values():
        quick, full = (
            [job for group in subject.jobs(plan).values() for job in group]
            for plan in (QUICK_RADIO, RadioPlan())
        )
        assert 0 < len(quick) <= len(full)
        assert pickle.dumps(full)


def test_unknown_subject_is_a_one_line_error():
    result = CliRunner().invoke(validate_radio_app, ["--only", "per,nonsense"])
    assert result.exit_code == BAD_INPUT
    assert result.stderr.count("\n") <= 2
    assert "nonsense" in result.stderr


def test_json_prints_only_numbers_and_the_page_is_written(tmp_path):
    result = CliRunner().invoke(validate_radio_app, ["--only", "per", "--json", "--out", str(tmp_path)])
    assert result.exit_code == FINE, result.stdout
    numbers = json.loads(result.stdout)["checks"]
    assert len(numbers) == len(ns3_error_curves())
    assert {number["met"] for number in numbers} == {True}
    assert "px4" not in numbers[0]
    page = (tmp_path / "radio-validation.md").read_text(encoding="utf-8")
    assert page.startswith("# Validation of the radio\n")
    assert "| ofdm6 |" in page
    assert (tmp_path / "images" / "radio-per.png").exists()


# ---- benchmark


def test_article_traffic_is_recorded_without_a_flight_and_repeatable():
    """Eight UAVs send ten beacons a second each, and in each second a request to every other one.

    The first second has fewer requests, because ranging starts after the first beacon of a station.
    """
    scenario, seconds = load(ARTICLE), 3.0
    steps = record(scenario, seconds)
    items = [item for step in steps for batch in step.batches for item in batch.items]
    assert sum(isinstance(item, Broadcast) for item in items) == pytest.approx(8 * 10 * seconds, abs=8)
    assert 8 * 7 * (seconds - 1.0) <= sum(isinstance(item, FtmRequest) for item in items) <= 8 * 7 * seconds
    # the beacons contain distances, so sessions completed
    assert (
        max(len(item.payload) for item in items if isinstance(item, Broadcast))
        == HEADER_BYTES + 7 * RANGE_BYTES
    )
    frames, run = play(scenario, steps)
    assert (frames, run) == play(scenario, steps)
    # RTS, CTS and data of every beacon; request, eight measurement frames and their ACKs of every session
    assert frames > 8 * 10 * seconds * 3 + 18 * 8 * 7 * (seconds - 1.0) - 50
    assert 0 < run < len(steps)


def test_scheduled_events_can_be_replayed_without_effect():
    """Two simultaneous calls; the first schedules a third one after the end of the interval."""
    schedule, run_until = EventQueue.at, EventQueue.run_until
    with _scheduling() as intervals:
        queue, done = EventQueue(), []
        queue.at(5, lambda _: queue.at(20, done.append, 3), None)
        queue.at(7, done.append, 2)
        queue.run_until(10)
        queue.run_until(30)
    assert done == [2, 3]
    assert intervals == [(10, [5, 7, 20]), (30, [])]
    assert (EventQueue.at, EventQueue.run_until) == (schedule, run_until)
    _play_empty(intervals)


def test_peer_program_is_timed():
    """A peer that computes for at least 0.3 s and simulates two seconds costs 0.15 s a second."""
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    cost = bench_saturated(
        stations=2, rate_mbps=6, seconds=0.5, peer=[sys.executable, "-S", "-c", busy], peer_s=2.0, repeats=1
    )
    assert cost.peer is not None
    assert 0.15 <= cost.peer.cpu_s < 1.0
    assert cost.faster_cpu == pytest.approx(cost.peer.cpu_s / cost.process.cpu_s)
    assert 0.0 < cost.run.cpu_s < cost.process.cpu_s


def test_failing_peer_is_a_one_line_error():
    command = shlex.join([sys.executable, "-c", "raise SystemExit(3)"])
    result = CliRunner().invoke(
        bench_radio_app, ["--peer", command, "--seconds", "0.5", "--stations", "2", "--repeats", "1"]
    )
    assert result.exit_code == BAD_INPUT
    assert "exit status 3" in " ".join(result.stderr.split())

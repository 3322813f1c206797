"""Tests of the programs study: routes over time, rates of reports, its radio models and judgements."""

from types import SimpleNamespace

import numpy as np
import pytest

from netsim.model.config import RadioConfig
from netsim.phy.errors import packet_error_rate
from netsim.phy.modes import phy_mode
from studies.programs import iperf_section, ping_section, route_watch, routes_section, tcp_section
from studies.programs.flight import Lateness, after, program
from studies.programs.iperf_section import Saturated, rate_hz, reported_bps
from studies.programs.plan import ProgramsPlan
from studies.programs.radio_models import FrameLoss, LossSettings
from studies.programs.route_history import all_connected, all_direct, first_s, hops, none_between
from studies.programs.routes_section import Closing, Line
from studies.programs.tcp_section import Transfer

PROC_NET_ROUTE = """Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT
wlan0\t0000000A\t00000000\t0001\t0\t0\t0\t000000FF\t0\t0\t0
wlan0\t0100010A\t0100010A\t0007\t0\t0\t0\tFFFFFFFF\t0\t0\t0
wlan0\t0301010A\t0100010A\t0007\t0\t0\t0\tFFFFFFFF\t0\t0\t0
*\t0400010A\t00000000\t0205\t0\t0\t-1\tFFFFFFFF\t0\t0\t0
wlan0\tFFFFFFFF\t00000000\t0005\t0\t0\t0\tFFFFFFFF\t0\t0\t0
"""
ON_TIME = Lateness(late_fraction=0.0, mean_ms=1.0, largest_ms=2.0)


def test_watch_reads_host_routes_and_skips_unreachable_ones():
    assert route_watch.routes(PROC_NET_ROUTE) == {1: 1, 0x103: 1}


LOGS = {
    0: '1.0 {}\n3.0 {"1": 1}\n5.0 {"1": 1, "2": 1}\n9.0 {"1": 1}\n12.0 {"1": 1, "2": 2}\n',
    1: '1.0 {}\n4.0 {"0": 0, "2": 2}\n',
    2: '1.0 {}\n6.0 {"0": 1, "1": 1}\n9.5 {"1": 1}\n11.0 {"0": 0, "1": 1}\n',
}


def test_first_time_of_a_condition_over_the_changes_of_all_vehicles():
    assert first_s(LOGS, all_connected(range(3)), from_s=0.0) == 6.0
    assert first_s(LOGS, all_connected(range(3)), from_s=7.0) == 7.0
    assert first_s(LOGS, none_between([0], [2]), from_s=7.0) == 9.5
    assert first_s(LOGS, all_direct(range(3)), from_s=7.0) == 12.0
    assert first_s(LOGS, all_direct([0, 3]), from_s=0.0) is None


def test_hops_follow_the_tables_and_end_in_loops():
    assert hops({0: {2: 1}, 1: {2: 2}}, 0, 2) == 2
    assert hops({0: {2: 1}, 1: {}}, 0, 2) is None
    assert hops({0: {2: 1}, 1: {2: 0}}, 0, 2) is None


def server(begin_s, rates_bps):
    intervals = [{"sum": {"start": i, "end": i + 1.0, "bytes": rate / 8}} for i, rate in enumerate(rates_bps)]
    return {"start": {"timestamp": {"timesecs": begin_s}}, "intervals": intervals}


def test_reported_rate_is_that_of_the_time_in_which_all_servers_receive():
    alone = [9e6] * 3  # the second server begins 3 s later
    servers = [server(100, [*alone, *[2e6] * 7]), server(103, [*[1e6] * 7, *alone])]
    marks = [(90.0, 0.0), (120.0, 6.0)]  # at a fifth of the wall clock
    assert reported_bps(servers, marks, 1.0) == pytest.approx(5 * 3e6)


def test_rate_leaves_the_edges_out():
    times_s = np.concatenate([np.linspace(0.0, 1.0, 5), np.arange(1.0, 9.0, 0.01), np.linspace(9.0, 10.0, 5)])
    assert rate_hz(times_s, 1.0) == pytest.approx(100.0, rel=0.01)


def test_frame_loss_is_the_fraction_of_frames_of_the_stated_length():
    model = FrameLoss(None, LossSettings(fraction=0.1, frame_bytes=1_536))
    hazard = model.hazard(phy_mode("ofdm6", 20))(20.0)
    assert 1.0 - np.exp(-8 * 1_536 * hazard) == pytest.approx(0.1)
    assert packet_error_rate(phy_mode("ofdm6", 20), 1_536, 1e3) == 0.0  # the built-in model loses none


def test_round_trip_of_the_channel_is_two_accesses_and_frames():
    config = RadioConfig(broadcast_rts=False, rician_k_db=None, fading="none")
    short_ms, long_ms = (np.median(ping_section.channel_round_trips_ms(config, n, 5)) for n in (56, 1_400))
    # twice the additional octets at 24 Mbit/s
    assert long_ms - short_ms == pytest.approx(2 * 8 * (1_400 - 56) / 24e3, abs=0.03)
    # AIFS of 43 us and a preamble of 20 us at least, twice
    assert short_ms > 2 * 0.063


def saturated(**changed):
    usual = {
        "senders": 2, "reported_mbps": 15.0, "logged_mbps": 15.1, "lab_mbps": 15.2, "lateness": ON_TIME,
        "reported_datagrams": 1_000, "logged_datagrams": 1_003,
    }  # fmt: skip
    return Saturated(**usual | changed)


def transfer(**changed):
    usual = {
        "loss": 0.1, "retry_limit": 6, "lost_fraction": 0.1, "retransmitted_segments": 0, "frames": 1_000,
        "lateness": ON_TIME,
    }  # fmt: skip
    return Transfer(**usual | changed)


def failed(section):
    return [check.name for check in section.checks if not check.passed]


def test_judgements():
    plan = ProgramsPlan()
    assert failed(iperf_section.judge(plan, {"saturated": [saturated()]})) == []
    wrong = saturated(lab_mbps=16.0, reported_datagrams=1_004)
    assert len(failed(iperf_section.judge(plan, {"saturated": [wrong]}))) == 2
    clean = transfer(loss=0.0, lost_fraction=0.0, goodput_mbps=8.0)
    retried = transfer(goodput_mbps=7.0, retransmitted_segments=1)
    bare = transfer(retry_limit=0, goodput_mbps=2.0, retransmitted_segments=120)
    assert failed(tcp_section.judge(plan, {"tcp": [clean, retried, bare]})) == []
    assert len(failed(tcp_section.judge(plan, {"tcp": [clean, bare, bare]}))) == 3
    line = Line(seed=1, converged_s=5.0, answered=19, withdrawn_s=4.0, lateness=ON_TIME)
    closing = Closing(seed=1, converged_s=5.0, shortened_s=40.0, in_range_s=35.0, lateness=ON_TIME)
    assert failed(routes_section.judge(plan, {"lines": [line], "closing": [closing]})) == []
    never = Line(seed=2, converged_s=5.0, answered=19, withdrawn_s=None, lateness=ON_TIME)
    found = failed(routes_section.judge(plan, {"lines": [line, never], "closing": [closing]}))
    assert found == ["slowest withdrawal"]


def test_tables_of_programs_are_toml_of_the_scenario():
    text = program("ping", 0, after(1.5, "ping", "-c", 3), environment={"A": 'b"\\'})
    assert 'command = ["sh", "-c", "sleep 1.5; exec \\"$@\\"", "sh", "ping", "-c", "3"]' in text
    assert 'environment = { A = "b\\"\\\\" }' in text


def test_missing_program_is_one_line(monkeypatch, capsys):
    from studies.programs import cli  # noqa: PLC0415  changed by this test

    monkeypatch.setattr(cli, "shutil", SimpleNamespace(which=lambda _: None))
    monkeypatch.setattr(cli, "why_not", lambda: None)
    with pytest.raises(SystemExit) as ended:
        cli.programs_app(["--only", "routes"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "coflight study programs: babeld is not installed\n"

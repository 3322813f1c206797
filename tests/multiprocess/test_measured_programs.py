"""iperf3, TCP with losses, sockets of a script, and babeld on vehicles, against the frame log."""

import json
import re
import sys
import time

import numpy as np
import pytest
from vehicle_programs import needs

from harness.launch.swarm import Swarm
from netsim.network.namespaces import why_not
from studies.programs import iperf_section, routes_section, tcp_section
from studies.programs.flight import (
    NO_APPLICATION,
    SNAP_AND_MAC_BYTES,
    UDP_AND_IP_BYTES,
    data_frames,
    program,
    read,
    run_until_report,
)
from studies.programs.route_history import all_connected, first_s, hops, none_between

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]

DEADLINE_S = 40.0
TWO_SOCKETS = """
import select, socket, sys, time
uav, count = int(sys.argv[1]), int(sys.argv[2])
listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
listening.bind(("", 5005))
sending = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sending.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
wall_next_s, number = time.monotonic() + 1.0, 0
while True:
    if select.select([listening], [], [], max(0.0, wall_next_s - time.monotonic()))[0]:
        data, (host, _) = listening.recvfrom(2048)
        print("received", host, *data.decode().split()[:2], flush=True)
    elif number < 10:
        for kind, host in (("one", f"10.1.0.{(uav + 1) % count}"), ("all", "10.255.255.255")):
            sending.sendto(f"{kind} {number}".ljust(300).encode(), (host, 5005))
        number, wall_next_s = number + 1, time.monotonic() + 0.1
    else:
        wall_next_s = time.monotonic() + 1.0
"""


def swarm(tmp_path, text, *, speed):
    path = tmp_path / "programs.toml"
    path.write_text(text)
    return Swarm(path, speed=speed, out=tmp_path / "run")


def fly_until(swarm, condition):
    """Fly until a condition of the files holds."""
    wall_end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < wall_end_s
        swarm.run_for(0.5 * (min(1.0, swarm.speed)))


def flown(swarm):
    swarm.summary(draw=False)
    assert swarm.leftovers() == []
    return read(swarm.path, swarm.scenario.radio)


def log_of(swarm, uav, name):
    path = swarm.path / "logs" / f"uav-{uav}-{name}.log"
    return path.read_text() if path.exists() else ""


@needs("iperf3")
def test_iperf3_reports_the_datagrams_of_the_frame_log(tmp_path):
    wall_s, speed = 4.0, 0.5
    text = iperf_section.scenario(1, wall_s, speed, 3.0)
    with swarm(tmp_path, text, speed=speed) as flight:
        run_until_report(flight, 1, "server0", limit_s=DEADLINE_S)
        records = flown(flight)
    report = json.loads(records.logs[1, "server0"])
    assert "error" not in report
    frames = data_frames(records.frames, iperf_section.PAYLOAD_BYTES + UDP_AND_IP_BYTES, source=0, to=1)
    delivered = int(np.count_nonzero(frames & (records.frames["delivered"] > 0)))
    reported = sum(each["sum"]["bytes"] for each in report["intervals"]) // iperf_section.PAYLOAD_BYTES
    assert reported == delivered
    # 3 Mbit/s of simulated time, which the machine may stretch
    assert delivered == pytest.approx(3e6 * speed * wall_s / (8 * iperf_section.PAYLOAD_BYTES), rel=0.1)
    times_s = records.frames["start_ns"][frames] * 1e-9
    assert iperf_section.rate_hz(times_s, 0.2) * 8e3 == pytest.approx(3e6, rel=0.2)


@needs("iperf3")
def test_tcp_completes_over_a_link_that_loses_frames(tmp_path):
    text = tcp_section.scenario(0.1, 6, 2.0)
    with swarm(tmp_path, text, speed=1) as flight:
        run_until_report(flight, 0, "client", limit_s=DEADLINE_S)
        records = flown(flight)
    report = json.loads(records.logs[0, "client"])
    assert "error" not in report
    segments = data_frames(records.frames, tcp_section.SEGMENT_IP_BYTES, source=0, to=1)
    lost = records.frames["lost_to_noise"][segments] > 0
    deviation = np.sqrt(0.1 * 0.9 / len(lost))
    assert lost.mean() == pytest.approx(0.1, abs=5.0 * deviation)
    received_bytes = report["end"]["sum_received"]["bytes"]
    assert 0 < received_bytes <= report["end"]["sum_sent"]["bytes"]
    # each byte of the stream was in a delivered segment, whose TCP header has 12 bytes of options
    delivered = np.count_nonzero(records.frames["delivered"][segments])
    assert received_bytes / (tcp_section.SEGMENT_IP_BYTES - 52) <= delivered + 5


def test_script_with_two_sockets_sends_to_one_and_to_all(tmp_path):
    agents = 3
    command = (sys.executable, "-I", "-S", "-c", TWO_SOCKETS, "{uav}", str(agents))
    text = f"agents = {agents}\n[formation]\nshape = 'line'\n[radio]\nbroadcast_rts = false\n{NO_APPLICATION}"
    with swarm(tmp_path, text + program("sockets", "all", command), speed=1) as flight:

        def received(uav):
            return re.findall(r"received 10\.1\.0\.(\d+) (one|all) (\d+)", log_of(flight, uav, "sockets"))

        def all_have_their_unicasts():
            return all(sum(kind == "one" for _, kind, _ in received(uav)) >= 10 for uav in range(agents))

        fly_until(flight, all_have_their_unicasts)
        flight.run_for(0.5)
        records = flown(flight)
        found = {uav: received(uav) for uav in range(agents)}
    for uav in range(agents):
        before = (uav - 1) % agents
        unicasts = [(int(source), int(number)) for source, kind, number in found[uav] if kind == "one"]
        assert unicasts == [(before, number) for number in range(10)]
        # the kernel delivers a broadcast to the sender's host too
        assert {int(source) for source, kind, _ in found[uav] if kind == "all"} == set(range(agents))
    length = 300 + UDP_AND_IP_BYTES + SNAP_AND_MAC_BYTES
    frames = records.frames
    grouped = (frames["bytes"] == length) & (frames["destination"] < 0)
    receptions = sum(
        kind == "all" and int(source) != uav for uav, each in found.items() for source, kind, _ in each
    )
    assert frames["delivered"][grouped].sum() == receptions


@needs("babeld", "ping")
def test_babeld_routes_over_four_hops_and_withdraws_them(tmp_path):
    uavs, middle = routes_section.UAVS, routes_section.MIDDLE
    text = routes_section.line_scenario(folder=str(tmp_path), ping_after_s=3.0, pings=200)
    with swarm(tmp_path, text, speed=1) as flight:

        def reached(condition, from_s):
            logs = {uav: log_of(flight, uav, "routes") for uav in uavs}
            return first_s(logs, condition, from_s=from_s) is not None

        def over_four_hops(tables):
            return all_connected(uavs)(tables) and hops(tables, uavs[0], uavs[-1]) == 4

        fly_until(flight, lambda: reached(over_four_hops, 0.0))
        fly_until(flight, lambda: "ttl=61" in log_of(flight, uavs[0], "ping"))  # three have forwarded it
        flight.kill(middle)
        killed_s = time.monotonic()
        fly_until(flight, lambda: reached(none_between(uavs[:middle], uavs[middle + 1 :]), killed_s))
        flown(flight)

"""Unmodified programs in the network namespaces of flying vehicles, whose datagrams cross the channel."""

import collections
import json
import subprocess
import sys
import time

import psutil
import pyarrow.parquet as pq
import pytest
from paths import ROOT

from harness.cli.progress import describe
from harness.launch.swarm import Swarm, SwarmError
from harness.simulator.messages import Paused
from netsim.network.interfaces import link_local_address
from netsim.network.namespaces import why_not

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]

AGENTS = 8
PAYLOAD_BYTES = 700
FRAME_BYTES = PAYLOAD_BYTES + 8 + 20 + 8 + 28
"""UDP, IPv4 and LLC/SNAP headers, and MAC header with FCS"""
SCENARIO = f"""
agents = {AGENTS}
[radio]
broadcast_rts = false
fading = "rician"
extra_attenuation_db = 8.0
[[programs]]
name = "exchange"
# the programs of all vehicles listen before the first one sends
command = ["{sys.executable}", "exchange.py", "--id={{uav}}", "--bytes={PAYLOAD_BYTES}", "--wait-s=2"]
folder = "{ROOT / "examples" / "udp-exchange"}"
"""
DEADLINE_S = 20.0


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "exchange.toml"
    path.write_text(SCENARIO)
    return path


def lines_of(run):
    """Return the lines of each vehicle's program so far, by vehicle."""
    return [(run / "logs" / f"uav-{uav}-exchange.log").read_text().splitlines() for uav in range(AGENTS)]


def count(run, word):
    return sum(line.startswith(word) for lines in lines_of(run) for line in lines)


def received_of(run):
    return count(run, "received")


def settled(run):
    """Return the number of receptions once it has not grown for a second, while simulated time rests."""
    wall_end_s, last, wall_last_s = time.monotonic() + DEADLINE_S, received_of(run), time.monotonic()
    while time.monotonic() - wall_last_s < 1.0:
        assert time.monotonic() < wall_end_s
        time.sleep(0.05)
        now = received_of(run)
        if now != last:
            last, wall_last_s = now, time.monotonic()
    return last


def test_broadcasts_of_two_scripts_arrive_as_the_frame_log_says(scenario, tmp_path):
    with Swarm(scenario, speed=1, out=tmp_path / "run") as swarm:
        swarm.run(until_s=6.0)
        before = received_of(swarm.path)
        assert before > 0
        swarm.cut_channel()
        swarm.run_for(1.0)
        cut = settled(swarm.path)
        swarm.run_for(2.0)
        assert received_of(swarm.path) == cut
        swarm.restore_channel()
        swarm.run_for(3.0)
        sent_in_flight = count(swarm.path, "sent")
        received = settled(swarm.path)
        assert received > cut
        summary = swarm.summary(draw=False)
        leftovers = swarm.leftovers()
    assert leftovers == []
    assert summary["deterministic"] is False
    packets = summary["program_packets"]
    assert packets["sent"] >= sent_in_flight
    assert 0 < packets["late"] + 1 <= packets["received"]
    lines = lines_of(swarm.path)
    assert sent_in_flight > AGENTS * 80
    frames = pq.read_table(swarm.path / "radio.parquet").to_pylist()
    exchanged = [frame for frame in frames if frame["bytes"] == FRAME_BYTES]
    delivered = sum(frame["delivered"] for frame in exchanged)
    assert delivered == received_of(swarm.path) == received
    # what is sent in the last second may not be on the air any more
    assert len(exchanged) == pytest.approx(sent_in_flight, abs=10 * AGENTS)
    pairs = collections.Counter(
        (uav, line.split()[1])
        for uav, each in enumerate(lines)
        for line in each
        if line.startswith("received")
    )
    assert len(pairs) == AGENTS * (AGENTS - 1)


def test_programs_that_fail_are_named_and_restarted(tmp_path):
    path = tmp_path / "failing.toml"
    path.write_text(
        'agents = 2\n[[programs]]\nname = "failing"\nuav = 1\n'
        'command = ["sh", "-c", "echo started; exit 3"]\nrestart = "on_failure"\n'
    )
    messages = []
    with Swarm(path, speed=1, out=tmp_path / "run", on_message=messages.append) as swarm:
        swarm.run(until_s=4.0)
        swarm.summary(draw=False)
        assert swarm.leftovers() == []
    lines = list(filter(None, map(describe, messages)))
    assert "uav 1: program failing ended with status 3; it is started again in 0.5 s" in lines, lines
    assert not any("SIGTERM" in line for line in lines), lines
    log = (tmp_path / "run" / "logs" / "uav-1-failing.log").read_text()
    assert log.count("started") >= 2


def test_stopped_network_ends_the_run(tmp_path):
    path = tmp_path / "network.toml"
    path.write_text("agents = 2\n[network]\nenabled = true\n")
    with Swarm(path, speed=1, out=tmp_path / "run") as swarm:
        swarm.run(until_s=0.5)
        (first,) = psutil.Process(swarm.pids["network"]).children()
        first.suspend()
        with pytest.raises(SwarmError, match=r"network .* is stopped"):
            swarm.run(until_s=30.0)
        swarm.stop()
        assert swarm.leftovers() == []
    assert not first.is_running() or first.status() == psutil.STATUS_ZOMBIE


def test_shell_enters_the_network_of_one_vehicle(tmp_path):
    path = tmp_path / "network.toml"
    path.write_text("agents = 3\n[network]\nenabled = true\n")
    with Swarm(path, speed=1, out=tmp_path / "run") as swarm:
        command = [sys.executable, "-m", "coflight", "shell", "2", "--run", str(swarm.path), "--"]
        addresses = subprocess.run(
            [*command, "cat", "/proc/net/dev", "/proc/net/if_inet6"],
            capture_output=True, text=True, timeout=DEADLINE_S, check=False,
        )  # fmt: skip
        assert addresses.returncode == 0, addresses.stderr
        assert "wlan0:" in addresses.stdout
        assert link_local_address(2).exploded.replace(":", "") in addresses.stdout
        wrong = subprocess.run(
            [*command[:4], "3", *command[5:], "true"],
            capture_output=True, text=True, timeout=DEADLINE_S, check=False,
        )  # fmt: skip
        assert wrong.returncode == 2
        assert "there is no UAV 3 among 3" in wrong.stderr
        wall_end_s = time.monotonic() + DEADLINE_S
        while swarm.simulated_s < 1.0 and time.monotonic() < wall_end_s:
            swarm.run_for(0.5)


def test_program_arms_its_own_vehicle_by_the_autopilots_link(tmp_path):
    code = tmp_path / "arm.py"
    code.write_text(
        "from pymavlink import mavutil\n"
        "link = mavutil.mavlink_connection('udpin:0.0.0.0:14540', source_system=255)\n"
        "systems = set()\n"
        "while not link.motors_armed():\n"
        "    beat = link.recv_match(type='HEARTBEAT', blocking=True)\n"
        "    systems.add(beat.get_srcSystem())\n"
        "    print(systems, flush=True)\n"
        "    link.target_system = beat.get_srcSystem()\n"
        "    link.arducopter_arm()\n"
        "print('armed', *systems, flush=True)\n"
    )
    path = tmp_path / "arming.toml"
    path.write_text(
        "agents = 2\n[onboard]\nenabled = false\n"
        f'[[programs]]\nname = "arm"\nuav = 1\ncommand = ["{sys.executable}", "{code}"]\n'
    )
    messages = []
    with Swarm(path, speed=1, out=tmp_path / "run", on_message=messages.append) as swarm:
        log = swarm.path / "logs" / "uav-1-arm.log"
        wall_end_s = time.monotonic() + DEADLINE_S
        while "armed" not in log.read_text() and time.monotonic() < wall_end_s:
            swarm.run_for(0.5)
        assert log.read_text().splitlines()[-1] == "armed 2"
        summary = swarm.summary(draw=False)
        assert swarm.leftovers() == []
    *_, last = [each for each in messages if isinstance(each, Paused)]
    assert [each.armed for each in last.vehicles] == [False, True]
    assert summary["deterministic"] is False
    processes = json.loads((swarm.path / "manifest.json").read_text())["processes"]
    (network,) = [each for each in processes if each["name"] == "network"]
    relayed = network["details"]["autopilot_links"]
    assert relayed["to_programs"] > 100
    # on the air are some multicasts of the kernel alone
    assert pq.read_table(swarm.path / "radio.parquet").num_rows < relayed["to_programs"] / 2

"""MAVSDK flies vehicles of a swarm with --hold like PX4's."""

import statistics

import psutil
import pytest
from swarms import failures, findings

pytestmark = [pytest.mark.clients, pytest.mark.timeout(400)]


def test_a_px4_users_session_on_one_vehicle_while_the_others_hold(hold, client) -> None:
    swarm = hold()
    found = findings(client("mavsdk_flight.py", swarm.companion_port), wall_limit_s=280.0)
    assert failures(found) == []
    assert len(found) >= 64
    manifest = swarm.end()
    # only the contacted vehicle is named, and no other left the ground
    assert [line for line in manifest["nondeterminism"] if "received messages" in line] == [
        "uav 0 received messages from a ground station or companion"
    ]
    assert not any("touched" in line or "lost" in line for line in swarm.log_lines)


LEAST_IDLE = 0.1
"""Idle fraction of the machine's time below which a slow swarm is due to other load."""


def test_three_clients_on_three_vehicles_at_once(hold, client) -> None:
    swarm = hold()
    before = psutil.cpu_times()
    clients = [client("mavsdk_hop.py", swarm.companion_port + i, i + 1) for i in range(3)]
    for process in clients:
        found = findings(process, wall_limit_s=150.0)
        assert failures(found) == []
        assert found
    passed = [after - then for after, then in zip(psutil.cpu_times(), before, strict=True)]
    idle = passed[before._fields.index("idle")] / sum(passed)
    swarm.end()
    # the swarm keeps real time, if the machine has idle time
    assert statistics.median(swarm.pace) > 0.9 or idle < LEAST_IDLE, f"{swarm.pace}, {idle:.0%} idle"


def test_a_link_over_the_radio_is_lost_and_comes_back(hold, client) -> None:
    swarm = hold(
        "--set", "links.telemetry=radio",
        "--set", "stations=[{name='ground', pos_ned_m=[0.0, -10.0, 0.0]}]",
        "--set", "faults=[{kind='radio_attenuation', attenuation_db=200.0, start_s=30.0, duration_s=10.0}]",
    )  # fmt: skip
    found = findings(client("mavsdk_link.py", swarm.ground_station_port), wall_limit_s=280.0)
    assert failures(found) == []
    assert len(found) == 6
    manifest = swarm.end()
    assert "ground station ground received messages from a program over UDP" in manifest["nondeterminism"]

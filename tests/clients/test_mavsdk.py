"""MAVSDK flies vehicles of a swarm that holds, as it flies PX4's."""

import pytest
from swarms import failures, findings

pytestmark = [pytest.mark.clients, pytest.mark.timeout(400)]


def test_everything_that_a_user_of_px4_does_on_one_vehicle_while_the_others_hold(hold, client) -> None:
    swarm = hold(3100)
    found = findings(client("mavsdk_flight.py", swarm.companion_port), wall_limit_s=280.0)
    assert failures(found) == []
    assert len(found) >= 64
    manifest = swarm.end()
    # only who was spoken to is named, and nobody else left the ground
    assert [line for line in manifest["nondeterminism"] if "spoken to" in line] == [
        "uav 0 was spoken to by a ground station or companion"
    ]
    assert not any("touched" in line or "lost" in line for line in swarm.said)


def test_three_clients_on_three_vehicles_at_once(hold, client) -> None:
    swarm = hold(3200)
    clients = [client("mavsdk_hop.py", swarm.companion_port + i, i + 1) for i in range(3)]
    for process in clients:
        found = findings(process, wall_limit_s=150.0)
        assert failures(found) == []
        assert found
    swarm.end()
    assert max(swarm.pace) > 0.9, swarm.pace  # the clock's pace can be kept with all that

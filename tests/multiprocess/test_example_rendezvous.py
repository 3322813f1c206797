"""The example rendezvous beside stand-ins for PX4."""

import pytest
from paths import ROOT
from px4_swarms import px4_swarms

from harness.simulator.messages import Collision, VehicleLost

pytestmark = pytest.mark.multiprocess

SCENARIO = ROOT / "examples" / "rendezvous" / "rendezvous.toml"


def test_the_rendezvous_meets_beside_px4s(tmp_path):
    swarm = px4_swarms(tmp_path, SCENARIO)(3, speed=2.0, flies=True)
    with swarm:
        truth = swarm.run_until_formed(timeout_s=90.0)
        assert {vehicle.phase for vehicle in truth.vehicles} == {"met"}
        assert {vehicle.mode for vehicle in truth.vehicles} == {"Offboard"}
        assert [vehicle.values["neighbours"] for vehicle in truth.vehicles] == [2, 2, 2]
        assert max(vehicle.values["spread_m"] for vehicle in truth.vehicles) <= 2.0
        assert not any(isinstance(event, Collision | VehicleLost) for event in swarm.events)
    assert swarm.leftovers() == []

"""Four UAVs meet: within the derived time, without a collision, with lost beacons, equally in each mode."""

from itertools import combinations
from math import dist
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from rendezvous.application import Settings
from rendezvous.consensus import meeting_time_s, offsets_m, spread_m

from harness.simulator.messages import Collision

SCENARIO = Path(__file__).parents[1] / "rendezvous.toml"
SETTINGS = Settings()
VELOCITY_LAG_S = 2.0
"""Allowance for the vehicles, which do not have the velocity of the law at once."""
GPS_M = 4.0
"""Allowance for a pair's difference of GPS errors."""


def is_meeting(truth):
    return all(vehicle.phase == "meeting" for vehicle in truth.vehicles)


def pairs_m(positions):
    return [dist(a, b) for a, b in combinations(positions, 2)]


def begin_spread_m(flight):
    places = [(n, e) for n, e, _ in flight.scenario.places_ned_m().tolist()]
    offsets = offsets_m(places, SETTINGS.spacing_m)
    return spread_m([(p[0] - d[0], p[1] - d[1]) for p, d in zip(places, offsets, strict=True)])


@pytest.mark.parametrize("seed", [1, 2])
def test_they_meet_within_the_derived_time_and_keep_their_distances(swarm, seed):
    flight = swarm(SCENARIO, seed=seed)
    begin_s = flight.run_until(is_meeting, timeout_s=30).t_s
    bound_s = meeting_time_s(
        begin_spread_m(flight) + GPS_M, SETTINGS.tolerance_m, SETTINGS.gain_1_s, SETTINGS.speed_m_s
    )
    nearest_m = []

    def has_met(truth):
        nearest_m.append(min(pairs_m(truth.pos_ned_m)))
        return all(vehicle.phase == "met" for vehicle in truth.vehicles)

    truth = flight.run_until(has_met, timeout_s=bound_s + VELOCITY_LAG_S + SETTINGS.hold_s)
    assert truth.t_s - begin_s > SETTINGS.hold_s
    assert min(nearest_m) > SETTINGS.spacing_m - GPS_M
    assert max(pairs_m(truth.pos_ned_m)) < 0.5 * max(pairs_m(flight.scenario.places_ned_m()))
    assert max(vehicle.values["spread_m"] for vehicle in truth.vehicles) <= 2.0 * SETTINGS.tolerance_m
    flight.run_for(10.0)
    assert not any(isinstance(event, Collision) for event in flight.events)


def test_they_meet_also_if_many_beacons_are_lost(swarm, tmp_path):
    flight = swarm(SCENARIO, out=tmp_path / "run", overrides=["radio.extra_attenuation_db=11.0"])
    truth = flight.run_until_formed(timeout_s=90)
    assert max(vehicle.values["spread_m"] for vehicle in truth.vehicles) <= 2.0 * SETTINGS.tolerance_m
    assert not any(isinstance(event, Collision) for event in flight.events)
    flight.summary(draw=False)
    frames = pq.read_table(tmp_path / "run" / "radio.parquet").to_pandas()
    beacons = frames[frames["kind"] == "data"]
    lost, delivered = beacons["lost_to_noise"].sum(), beacons["delivered"].sum()
    assert lost > 0.2 * (lost + delivered)


def test_the_others_meet_without_a_uav_that_is_lost(swarm):
    flight = swarm(SCENARIO)
    flight.run_until(is_meeting, timeout_s=30)
    flight.kill(3)
    truth = flight.run_until_formed(timeout_s=40)
    assert truth.alive.tolist() == [True, True, True, False]
    # the lost one is forgotten, so the mean is that of the others
    assert [vehicle.values["neighbours"] for vehicle in truth.vehicles[:3]] == [2, 2, 2]


def test_the_flight_is_the_same_in_one_process_and_in_many(swarm, tmp_path):
    hashes = set()
    for processes in ("one", "many"):
        flight = swarm(SCENARIO, seed=5, processes=processes, out=tmp_path / processes)
        flight.run(until_s=20.0)
        hashes.add(flight.summary(draw=False)["log_sha256"])
    assert len(hashes) == 1

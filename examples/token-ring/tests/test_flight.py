"""The ring beside the formation: one holder, rounds that advance, survival of a loss, equal logs."""

from pathlib import Path

from token_ring.protocol import Timing

SCENARIO = Path(__file__).parents[1] / "formation.toml"
TIMING = Timing(stations=4, hold_us=80_000, pass_us=160_000)
ROUND_S = 1e-6 * 4 * (TIMING.hold_us + TIMING.pass_us)
"""Longest round in which no station is lost."""


def numbers(truth, name):
    return [vehicle.values[f"ring_{name}"] for vehicle in truth.vehicles if vehicle.alive]


def test_the_token_has_one_holder_while_the_formation_forms(swarm):
    flight, holders = swarm(SCENARIO), []

    def has_formed(truth):
        holders.append(sum(vehicle.values.get("ring_phase", 0) for vehicle in truth.vehicles))
        return all(vehicle.phase == "on station" for vehicle in truth.vehicles)

    begin = flight.run_for(5.0)
    formed = flight.run_until(has_formed, timeout_s=40)
    assert max(holders) == 1
    assert sum(numbers(formed, "regenerated")) == 1
    least = int((formed.t_s - begin.t_s) / ROUND_S)
    assert min(numbers(formed, "rounds")) >= max(numbers(begin, "rounds")) + least - 1


def test_the_token_survives_the_loss_of_its_holder(swarm):
    flight = swarm(SCENARIO)
    flight.run_until_formed(timeout_s=40)
    before = flight.run_until(
        lambda truth: truth.vehicles[2].values["ring_phase"] == 1, timeout_s=2 * ROUND_S
    )
    flight.kill(2)
    flight.run_for(1e-6 * TIMING.timeout_us(3) + 0.5)
    after = flight.run_for(4 * ROUND_S)
    assert after.alive.tolist() == [True, True, False, True]
    assert sum(numbers(after, "regenerated")) >= 2
    assert min(numbers(after, "rounds")) >= max(numbers(before, "rounds")) + 3
    assert [vehicle.phase for vehicle in after.vehicles if vehicle.alive] == ["on station"] * 3


def test_the_flight_is_the_same_in_one_process_and_in_many(swarm, tmp_path):
    hashes = set()
    for processes in ("one", "many"):
        flight = swarm(SCENARIO, seed=5, processes=processes, out=tmp_path / processes)
        flight.run(until_s=12.0)
        hashes.add(flight.summary(draw=False)["log_sha256"])
    assert len(hashes) == 1

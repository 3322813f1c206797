"""Start of the formation's motion: from the vehicles' reports to the plan that the truth is compared with."""

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import stamp
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from harness.records.outcome import RunOutcome
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.report.report import finish
from harness.scenario.scenario_file import load
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.messages import FormationMoves
from harness.simulator.motion_start import agreed, flown_start_us, since_start_s, start_us
from harness.simulator.simulation import Simulation
from harness.simulator.truth_record import EVENT_KINDS

EASTWARDS = 'formation.motion={kind="track", speed_m_s=5.0, acceleration_m_s2=3.0, course_deg=90.0}'
SCENARIO = load(SCENARIOS / "ring.toml", ["agents=3", EASTWARDS])


def test_a_start_is_an_unsigned_number_of_milliseconds_in_a_signed_field():
    assert start_us(0) == 0
    assert start_us(12_345) == 12_345_000
    assert start_us(-2) == (2**32 - 2) * 1_000
    assert start_us(-1) == (2**32 - 1) * 1_000


@pytest.mark.parametrize(
    ("reported", "start"),
    [
        ([], None),
        ([5, 5, 7], 5),
        ([5, 5, 7, 7], None),
        ([5, None, None], None),
        ([5, 5, None], 5),
        ([None, None], None),
    ],
)
def test_more_than_half_agree(reported, start):
    assert agreed(reported) == start


def test_the_last_start_of_the_events_counts(tmp_path):
    events = tmp_path / "events.jsonl"
    events.write_bytes(b'{"event":"formed","time_us":4000}\n')
    assert flown_start_us(events) is None
    lines = [
        FormationMoves(time_us=8_000, start_us=2_000_000),
        FormationMoves(time_us=9_000, start_us=3_000_000),
    ]
    with events.open("ab") as file:
        file.write(b"".join(msgspec.json.encode(line) + b"\n" for line in lines))
        file.write(msgspec.json.encode(lines[0])[:-3])  # cut off when the process was killed
    assert flown_start_us(events) == 3_000_000
    times_us = np.array([2_000_000, 3_500_000])
    np.testing.assert_allclose(since_start_s(times_us, 3_000_000), [-1.0, 0.5])
    np.testing.assert_array_equal(since_start_s(times_us, None), [0.0, 0.0])
    assert FormationMoves.__struct_config__.tag in EVENT_KINDS


class _Slot:
    def __init__(self, instance):
        self.instance = instance
        self.alive = True


class _Idle:
    """Vehicles that are connected and set no motors."""

    def __init__(self, count):
        self.slots = [_Slot(i) for i in range(count)]
        self._inbox = ActuatorInbox(count)

    @property
    def living(self):
        return sum(slot.alive for slot in self.slots)

    def send(self, frames):
        assert len(list(frames)) == len(self.slots)

    def receive(self, time_us):
        assert time_us > 0
        return self._inbox

    def check(self, instances):
        raise AssertionError(instances)

    def close(self):
        pass


@pytest.fixture
def simulated(tmp_path):
    """Three vehicles on the ground below a formation that will fly east; the events; the run's folder."""
    folder = RunFolder(tmp_path / "run").create()
    config = msgspec.json.decode(
        folder.write_physics_config(SCENARIO, run_id="test").read_bytes(), type=PhysicsConfig
    )
    events = []
    simulation = Simulation(config, make_lockstep=lambda _: _Idle(3), emulator=None, emit=events.append)
    yield simulation, events, folder
    simulation.close()


def _report(simulation, instance, value, *, component=APPLICATION_COMPONENT, name=b"start_ms"):
    message = common.MAVLink_named_value_int_message(0, name, value)
    simulation.on_message(instance, stamp(message, system=instance + 1, component=component))


def test_the_start_that_most_living_vehicles_report_is_one_event(simulated):
    simulation, events, folder = simulated
    _report(simulation, 0, 4)
    _report(simulation, 1, 4, component=AUTOPILOT_COMPONENT)
    _report(simulation, 1, 4, name=b"other")
    simulation.step()
    assert events == []
    _report(simulation, 1, 8)
    _report(simulation, 1, 4)
    _report(simulation, 2, 8)
    simulation.step()
    moves = FormationMoves(time_us=12_000, start_us=4_000)
    assert events == [moves]
    _report(simulation, 2, 4)
    simulation.step()
    assert events == [moves]
    _report(simulation, 0, 5)  # no majority for another start: no event
    _report(simulation, 1, 6)
    simulation.step()
    assert events == [moves]
    for i in range(3):
        _report(simulation, i, 100)
    simulation.step()
    assert events == [moves, FormationMoves(time_us=24_000, start_us=100_000)]
    lines = folder.events.read_bytes().splitlines()
    assert [msgspec.json.decode(line, type=FormationMoves) for line in lines] == events


def test_reports_of_lost_vehicles_do_not_count(simulated):
    simulation, events, _ = simulated
    _report(simulation, 0, 4)
    _report(simulation, 1, 8)
    _report(simulation, 2, 8)
    for instance in (1, 2):
        simulation.lockstep.slots[instance].alive = False
        simulation.reports.on_lost(instance, "test")
    simulation.step()
    assert events[-1] == FormationMoves(time_us=8_000, start_us=4_000)


def test_the_error_of_a_vehicle_at_rest_is_the_motion_of_its_place(simulated):
    """The place has moved by a t^2 / 2 with 3 m/s^2 at t = 0.2 s since the start: 0.06 m."""
    simulation, _, _ = simulated
    for i in range(3):
        _report(simulation, i, 4)
    while simulation.time_us < 204_000:
        simulation.step()
    for vehicle in simulation.vehicles():
        assert vehicle.error_m == pytest.approx(0.06, abs=2e-3)


@pytest.mark.parametrize("start_ms", [None, 100])
def test_the_report_compares_the_flight_with_the_plan(simulated, start_ms):
    """Vehicles at rest fall behind the plan by 1.5 m/s^2 t^2; the shape has no error."""
    simulation, _, folder = simulated
    for i in range(3):
        if start_ms is not None:
            _report(simulation, i, start_ms)
    while simulation.time_us <= 500_000:
        simulation.step()
    simulation.close()
    outcome = RunOutcome(
        status="completed", command=(), speed=0.0, started_utc="", wall_s=1.0, formed_us=4_000,
        simulated_us=simulation.time_us, processes=(),
    )  # fmt: skip
    summary = finish(folder, SCENARIO, outcome, draw=False)
    flight = pq.read_table(folder.flight).to_pydict()
    behind_m = np.array(flight["desired_pos_ned_m.e"]) - np.array(flight["pos_ned_m.e"])
    since_s = np.array(flight["time_us"]) * 1e-6 - (0.1 if start_ms else 1e9)
    expected_m = np.where(since_s > 0.0, 1.5 * since_s**2, 0.0)
    np.testing.assert_allclose(behind_m, expected_m, atol=2e-3)
    np.testing.assert_allclose(flight["desired_pos_ned_m.d"], -10.0)
    assert summary["moves_s"] == (0.1 if start_ms else None)
    assert summary["formation_rms_m"]["shape_horizontal"] < 2e-3

"""The physics server's core: lost vehicles are disarmed, and errors leave nothing open."""

from pathlib import Path

import msgspec
import numpy as np
import psutil
import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common as mavlink
from world_truth import truth_with

from autopilot.mavlink.codec import stamp
from autopilot.mavlink.hil import HilActuatorControls
from foundation.processes.child_protocol import Warned
from foundation.records.record_log import read
from harness.records.run_folder import PhysicsConfig, RunFolder
from harness.scenario.scenario_file import load
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.simulation import Simulation
from harness.simulator.truth_record import truth_record

ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED"""
SCENARIO = load(SCENARIOS / "article.toml", ["agents=2"])


class _Slot:
    def __init__(self, instance):
        self.instance = instance
        self.alive = True


class _Armed:
    """Vehicles that are armed with their motors at rest until they are lost."""

    def __init__(self, error=None):
        self.slots = [_Slot(i) for i in range(2)]
        self.error = error
        self._inbox = ActuatorInbox(2)

    @property
    def living(self):
        return sum(slot.alive for slot in self.slots)

    def send(self, frames):
        assert len(list(frames)) == 2

    def receive(self, time_us):
        for slot in self.slots:
            if slot.alive:
                self._inbox.put(slot.instance, HilActuatorControls(time_us, (0.0,) * 16, ARMED, 1))
        return self._inbox

    def close(self):
        if self.error is not None:
            raise self.error


@pytest.fixture
def folder(tmp_path):
    return RunFolder(tmp_path / "run").create()


def simulation_of(folder, make_lockstep, **parts):
    path = folder.write_physics_config(SCENARIO, run_id="test")
    config = msgspec.json.decode(path.read_bytes(), type=PhysicsConfig)
    return Simulation(config, make_lockstep=make_lockstep, emulator=None, emit=lambda _: None, **parts)


def open_files(folder):
    return [
        file.path for file in psutil.Process().open_files() if Path(file.path).is_relative_to(folder.path)
    ]


def test_the_lost_are_disarmed_from_their_last_step_on(folder):
    vehicles = _Armed()
    simulation = simulation_of(folder, lambda _: vehicles)
    simulation.step()
    assert [vehicle.armed for vehicle in simulation.vehicles()] == [True, True]
    vehicles.slots[1].alive = False
    simulation.reports.on_lost(1, "of the test")
    for _ in range(11):  # a record is made every 40 ms, 10 steps
        simulation.step()
    assert [vehicle.armed for vehicle in simulation.vehicles()] == [True, False]
    simulation.close()
    truth = read(folder.raw_truth, truth_record(4))
    assert truth["armed"][-2:].tolist() == [True, False]
    assert np.array_equal(truth["alive"][-2:], truth["armed"][-2:])


class _ArduPilots(_Armed):
    """Two ArduPilots that do not have the scenario's parameter."""

    def send(self, frames):
        for slot, frame in zip(self.slots, frames, strict=True):
            assert not slot.alive or frame.startswith(b'\n{"timestamp":')


def test_a_parameter_is_unknown_to_those_ardupilots_that_are_in_the_run(folder):
    given = ("autopilot.kind=ardupilot", "autopilot.ardupilot_program=none", "autopilot.params.NO_SUCH=1")
    scenario = load(SCENARIOS / "article.toml", ["agents=2", *given])
    path = folder.write_physics_config(scenario, run_id="test")
    config = msgspec.json.decode(path.read_bytes(), type=PhysicsConfig)
    vehicles, events = _ArduPilots(), []
    simulation = Simulation(config, make_lockstep=lambda _: vehicles, emulator=None, emit=events.append)
    simulation.step()
    for instance in range(2):
        beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 1, 4, 3, 3)
        simulation.on_message(instance, stamp(beat, system=instance + 1, component=1))
    vehicles.slots[0].alive = False
    simulation.reports.on_lost(0, "of the test")
    for _ in range(8 * 250):
        simulation.step()
    simulation.close()
    assert [vehicle.mode for vehicle in simulation.vehicles()] == ["Guided", "Guided"]
    texts = {(event.name, event.text) for event in events if isinstance(event, Warned)}
    assert texts == {("uav 1", "autopilot.params.NO_SUCH: this ArduPilot has no such parameter")}


def test_a_failing_handshake_leaves_nothing_open(folder):
    met = []

    def make_lockstep(simulation):
        met.append(simulation)
        assert len(open_files(folder)) == 3
        raise OSError("of the test")

    with pytest.raises(OSError, match="of the test"):
        simulation_of(folder, make_lockstep)
    assert open_files(folder) == []
    assert met[0]._world._bullet._client is None


def test_vehicles_that_do_not_close_keep_neither_logs_nor_world_open(folder):
    simulation = simulation_of(folder, lambda _: _Armed(error=OSError("no space")))
    simulation.step()
    with pytest.raises(OSError, match="no space"):
        simulation.close()
    assert open_files(folder) == []
    assert simulation._world._bullet._client is None
    simulation.close()


class _Statues:
    """A physics engine whose vehicles stay where they were spawned."""

    vehicle_contacts = ()

    def __init__(self, *, spawn_pos_ned_m, **_):
        n = len(spawn_pos_ned_m)
        zeros = np.zeros((n, 3))
        self.truth = truth_with(
            pos_ned_m=spawn_pos_ned_m, vel_ned_m_s=zeros, q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
            omega_frd_rad_s=zeros, rotor_speed_rad_s=np.zeros((n, 4)), acc_ned_m_s2=zeros,
            specific_force_frd_m_s2=np.tile([0.0, 0.0, -9.8066], (n, 1)), mean_omega_frd_rad_s=zeros,
        )  # fmt: skip
        self.density_ratio = np.ones(n)
        self.calls = []

    def step(self, controls, armed, wind_force_ned_n, **_):
        self.calls.append((controls.shape, armed.tolist(), wind_force_ned_n.shape))

    def close(self):
        self.calls.append("close")


def test_another_physics_engine_is_stepped_and_closed(folder):
    simulation = simulation_of(folder, lambda _: _Armed(), physics=_Statues)
    for _ in range(3):
        simulation.step()
    engine = simulation._world
    assert [list(each.pos_ned_m) for each in simulation.vehicles()] == engine.truth.pos_ned_m.tolist()
    simulation.close()
    assert engine.calls == [((2, 4), [True, True], (2, 3))] * 3 + ["close"]

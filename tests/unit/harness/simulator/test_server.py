"""The simulator's commands: steps are only made while all vehicles are connected."""

import queue
from types import SimpleNamespace

from foundation.processes.child_protocol import Stop
from harness.simulator.messages import RunUntil, SetAttenuation
from harness.simulator.server import obey


class ConnectingSimulation:
    """A simulation whose two vehicles are not connected: one connects in each call of `connect`."""

    def __init__(self, inbox):
        self.inbox = inbox
        self.slots = [SimpleNamespace(alive=False) for _ in range(2)]
        self.lockstep = self
        self.time_us = 4_000
        self.any_alive, self.must_end, self.formed = True, False, False
        self.connected_at_steps = []

    @property
    def living(self):
        return sum(slot.alive for slot in self.slots)

    def connect(self, wall_timeout_s, *, keep_waiting):
        assert wall_timeout_s == 5.0
        self.slots[self.living].alive = True
        if self.living == 1:
            self.inbox.put(SetAttenuation(extra_attenuation_db=0.0))
            self.inbox.put(RunUntil(time_us=8_000))
            assert not keep_waiting()

    def step(self):
        self.connected_at_steps.append(self.living)
        self.time_us += 4_000
        self.inbox.put(Stop())

    def set_extra_attenuation_db(self, value):
        assert value == 0.0

    def settle(self):
        pass

    def notice_collisions(self):
        pass

    def vehicles(self):
        return ()


def test_no_step_is_made_before_all_vehicles_are_connected_though_a_command_interrupts_the_wait():
    inbox, events = queue.SimpleQueue(), []
    simulation = ConnectingSimulation(inbox)
    inbox.put(RunUntil(time_us=8_000))
    obey(simulation, inbox, connect_timeout_s=5.0, emit=events.append)
    assert simulation.connected_at_steps == [2]
    assert [(event.time_us, event.reason) for event in events] == [(4_000, "command"), (8_000, "time")]

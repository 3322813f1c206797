"""Mission progress as reported to stations: a timeline of messages without a flight. Under a second."""

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mission import MissionCommand, MissionItem, make_mission
from autopilot.navigation.mission_runner import MissionRunner
from autopilot.navigation.plan_items import mission_items, rally_item
from autopilot.navigation.plan_store import PlanStore, PlanType
from autopilot.services import mission_progress
from autopilot.services.mission_progress import (
    ACTIVE,
    COMPLETE,
    IN_MISSION,
    NO_MISSION,
    NO_TOTAL,
    NOT_STARTED,
    PAUSED,
    REPEAT_US,
    REPEATS,
    SUSPENDED,
    MissionProgress,
)
from autopilot.services.service import ALL, COMPANION, GROUND_STATION, NEVER_US, Partner

STATION = Partner(GROUND_STATION, 3)
WAYPOINT = MissionItem(command=MissionCommand.WAYPOINT, lat_deg=47.0, lon_deg=8.0, height_m=5.0)
PHOTO = MissionItem(command=MissionCommand.ACT, act=common.MAV_CMD_IMAGE_START_CAPTURE)
MARKER = MissionItem(command=MissionCommand.ACT, act=common.MAV_CMD_DO_LAND_START)


class Bench:
    """A mission's progress alone: the test changes runner and mode."""

    def __init__(self, *items):
        self.runner, self.plans = MissionRunner(), PlanStore()
        self.commander = SimpleNamespace(mode=FlightMode.HOLD)
        self.valid = True
        self.progress = MissionProgress(self.runner, self.plans, self.commander, is_valid=lambda: self.valid)
        self.now_us = 0
        if items:
            self.load(*items)

    def load(self, *items):
        mission = make_mission(items)
        self.plans.put(PlanType.MISSION, mission_items(mission))
        self.runner.load(mission)

    def due(self, until_us):
        """[(time, name, seq or text)] to the ground station; the companion receives the same."""
        sent = []
        while (deadline_us := max(self.progress.next_deadline_us(), self.now_us)) <= until_us:
            self.now_us = deadline_us
            messages = self.progress.on_timer(self.now_us)
            to = {link: [m for p, m in messages if p in (Partner(link), ALL)] for link in (0, 1)}
            assert to[GROUND_STATION] == to[COMPANION]
            sent += [(self.now_us, m.get_type(), getattr(m, "seq", getattr(m, "text", None))) for m in to[0]]
        self.now_us = until_us
        return sent

    def ask(self, seq):
        message = common.MAVLink_mission_set_current_message(1, 1, seq)
        return self.progress.on_message(message, self.now_us, STATION)


def test_states_are_px4s():
    bench = Bench()
    runner, progress = bench.runner, bench.progress
    current = progress.mission_current()
    assert (current.seq, current.total, current.mission_state) == (0, NO_TOTAL, NO_MISSION)
    bench.load(WAYPOINT, WAYPOINT)
    assert progress.state == NOT_STARTED
    for mode in (FlightMode.MISSION, FlightMode.TAKEOFF, FlightMode.LAND):
        bench.commander.mode = mode
        assert (progress.state, progress.mission_current().mission_mode) == (ACTIVE, IN_MISSION)
    bench.commander.mode = FlightMode.HOLD
    assert progress.state == NOT_STARTED  # no item was reached
    runner.advance()
    assert (progress.state, progress.mission_current().mission_mode) == (PAUSED, SUSPENDED)
    runner.advance()
    assert progress.state == COMPLETE
    assert (progress.mission_current().seq, progress.mission_current().total) == (1, 2)
    bench.valid = False
    assert progress.state == NO_MISSION


def test_ids_are_those_of_the_plans():
    bench = Bench(WAYPOINT)
    bench.plans.put(PlanType.RALLY, [rally_item(47.0, 8.0, 5.0)])
    current = bench.progress.mission_current()
    assert current.mission_id == bench.plans[PlanType.MISSION].opaque_id != 0
    assert (current.fence_id, current.rally_points_id) == (0, bench.plans[PlanType.RALLY].opaque_id)
    assert current.rally_points_id != 0


def test_reached_items_are_reported_at_once_and_the_last_ten_times_again():
    bench = Bench(PHOTO, WAYPOINT, MARKER, WAYPOINT)
    assert bench.due(0) == [(0, "MISSION_CURRENT", 0)]
    assert bench.progress.next_deadline_us() == NEVER_US
    bench.commander.mode = FlightMode.MISSION
    bench.runner.settle()
    assert bench.due(500) == [
        (0, "MISSION_ITEM_REACHED", 0), (0, "STATUSTEXT", "Mission: take photo (item 0)"),
        (0, "MISSION_CURRENT", 1),
    ]  # fmt: skip
    bench.runner.advance()
    reached = [(500, "MISSION_ITEM_REACHED", 1), (500, "MISSION_ITEM_REACHED", 2)]
    assert bench.due(600) == [*reached, (500, "MISSION_CURRENT", 3)]
    again = bench.due(100 * REPEAT_US)
    assert again == [(500 + k * REPEAT_US, "MISSION_ITEM_REACHED", 2) for k in range(1, REPEATS + 1)]
    assert bench.progress.next_deadline_us() == NEVER_US


def test_another_mission_ends_the_repetitions():
    bench = Bench(WAYPOINT, WAYPOINT)
    bench.runner.advance()
    bench.due(10)
    bench.load(WAYPOINT)
    assert bench.due(100 * REPEAT_US) == [(10, "MISSION_CURRENT", 0)]


def test_mission_set_current_is_answered_with_the_new_item():
    bench = Bench(WAYPOINT, PHOTO, WAYPOINT)
    bench.due(0)
    answers = bench.ask(1)  # an item that is not flown: current until the vehicle passes it
    assert [(partner, message.get_type(), message.seq) for partner, message in answers] == [
        (Partner(GROUND_STATION), "MISSION_CURRENT", 1), (Partner(COMPANION), "MISSION_CURRENT", 1),
    ]  # fmt: skip
    assert bench.runner.current == 1
    assert bench.due(REPEAT_US) == []  # already reported
    again = bench.ask(1)
    assert [message.seq for _, message in again] == [1, 1]


@pytest.mark.parametrize("items", [(), (WAYPOINT, WAYPOINT)])
def test_an_invalid_item_is_refused_with_a_text_and_no_change(items):
    bench = Bench(*items)
    version = bench.runner.version
    text, current = bench.ask(2)
    assert (text.partner, text.message.text) == (ALL, "Mission: there is no item 2")
    assert (current.partner, current.message.seq) == (STATION, 0)
    assert bench.runner.version == version
    assert not bench.progress.set_current(65_535)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 65_535) | st.none(), max_size=30))
def test_any_requests_leave_the_state_bounded(steps):
    loop = MissionItem(command=MissionCommand.JUMP, jump_to=0, jump_count=-1)
    bench = Bench(*[PHOTO] * 200, MissionItem(command=MissionCommand.DELAY), loop)
    for seq in steps:
        if seq is None:
            bench.runner.advance()
        else:
            bench.ask(seq % 203)
        bench.now_us += 1
        messages = bench.progress.on_timer(bench.now_us)
        assert len(messages) <= 3 * mission_progress._AT_ONCE + 4
        assert len(bench.runner.done) <= 1_000

"""Mission progress: MISSION_CURRENT, MISSION_ITEM_REACHED, and MISSION_SET_CURRENT.

States and repetitions are PX4's (src/modules/mavlink/mavlink_mission.cpp). MISSION_CURRENT is sent here when
its content changes, and once a second by `MessageStreams`.
"""

from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import MissionCurrent
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mission import MissionCommand, MissionError
from autopilot.navigation.mission_items import ACTS
from autopilot.navigation.mission_runner import MissionRunner
from autopilot.navigation.plan_store import PlanStore, PlanType
from autopilot.services.service import (
    ALL,
    COMPANION,
    GROUND_STATION,
    NEVER_US,
    Addressed,
    Partner,
    Service,
    reply,
)
from autopilot.services.status import status_text

NO_MISSION, NOT_STARTED, ACTIVE, PAUSED, COMPLETE = 1, 2, 3, 4, 5
"""MISSION_STATE"""
IN_MISSION, SUSPENDED = 1, 2
"""Values of ``mission_mode``."""
NO_TOTAL = 65_535
"""``total`` without a mission."""
REPEAT_US = 1_000_000
REPEATS = 10
"""Repetitions of the last MISSION_ITEM_REACHED."""
_AT_ONCE = 50
"""Most items reported in one step; the others follow."""
_MISSION_MODES = {FlightMode.MISSION, FlightMode.TAKEOFF, FlightMode.LAND}
"""Modes in which PX4 reports a mission as active."""


class MissionProgress(Service):
    """Reports the progress of a vehicle's mission, and sets its current item."""

    def __init__(
        self, runner: MissionRunner, plans: PlanStore, commander: Commander, *, is_valid: Callable[[], bool]
    ) -> None:
        """``is_valid`` returns whether the mission may be started."""
        super().__init__(MISSION_SET_CURRENT=self._on_set_current)
        self._runner = runner
        self._plans = plans
        self._commander = commander
        self._is_valid = is_valid
        self._version = runner.version
        self._reported: tuple[int, ...] = ()
        """Content of the last MISSION_CURRENT that was sent unrequested."""
        self._reached = 0
        self._repeats = REPEATS
        """Number of repetitions of the last item reached."""

    # ---- queries and actions

    @property
    def state(self) -> int:
        """MISSION_STATE."""
        runner = self._runner
        if runner.mission is None or not self._is_valid():
            return NO_MISSION
        if runner.finished:
            return COMPLETE
        if self._commander.mode in _MISSION_MODES:
            return ACTIVE
        return PAUSED if runner.begun else NOT_STARTED

    def mission_current(self) -> Message:
        """MISSION_CURRENT."""
        return MissionCurrent(*self._content())

    def has_item(self, seq: int) -> bool:
        """Whether the mission has an item of this number."""
        mission = self._runner.mission
        return mission is not None and 0 <= seq < len(mission.items)

    def set_current(self, seq: int) -> bool:
        """Continue with another item; False, without any change, if there is no such item."""
        try:
            self._runner.set_current(seq)
        except MissionError:
            return False
        return True

    @property
    def has_news(self) -> bool:
        """Whether the mission has progressed since the last `on_timer`."""
        return self._runner.version != self._version or bool(self._runner.done)

    # ---- service

    def _on_set_current(self, message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Set the current item if it exists; answer with MISSION_CURRENT in either case."""
        if self.set_current(message.seq):
            self._reported = self._content()
            return _outside(self.mission_current())
        text = status_text(common.MAV_SEVERITY_WARNING, f"Mission: there is no item {message.seq}")
        return [*reply(ALL, text), *reply(partner, self.mission_current())]

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Report items reached and the current item, and repeat the last report of a reached item."""
        runner = self._runner
        self._version = runner.version
        messages: list[Addressed] = []
        if not runner.begun:
            self._repeats, self.due_us = REPEATS, NEVER_US
        elif now_us >= self.due_us and not runner.done:
            self._repeats += 1
            self.due_us = now_us + REPEAT_US if self._repeats < REPEATS else NEVER_US
            messages += _outside(_item_reached(self._reached))
        for _ in range(min(len(runner.done), _AT_ONCE)):
            self._reached = runner.done.popleft()
            self._repeats, self.due_us = 0, now_us + REPEAT_US
            messages += self._item_reports(self._reached)
        if (content := self._content()) != self._reported:
            self._reported = content
            messages += _outside(self.mission_current())
        return messages

    def next_deadline_us(self) -> int:
        """0 if the mission has progressed; else the time of the next repetition."""
        return 0 if self.has_news else self.due_us

    # ---- pieces

    def _content(self) -> tuple[int, ...]:
        runner, plans = self._runner, self._plans
        total = 0 if runner.mission is None else len(runner.mission.items)
        return (
            runner.current if total else 0,
            total or NO_TOTAL,
            self.state,
            IN_MISSION if self._commander.mode in _MISSION_MODES else SUSPENDED,
            *(plans[kind].opaque_id for kind in PlanType),
        )

    def _item_reports(self, index: int) -> list[Addressed]:
        """MISSION_ITEM_REACHED, and a STATUSTEXT for acts that are not simulated: camera, gimbal, payload."""
        messages = _outside(_item_reached(index))
        mission = self._runner.mission
        if mission is not None and index < len(mission.items):
            item = mission.items[index]
            if item.command is MissionCommand.ACT and ACTS.get(item.act):
                text = f"Mission: {ACTS[item.act]} (item {index})"
                messages += reply(ALL, status_text(common.MAV_SEVERITY_INFO, text))
        return messages


def _item_reached(index: int) -> Message:
    return common.MAVLink_mission_item_reached_message(index)


def _outside(message: Message) -> list[Addressed]:
    """Address a message to all external partners; the application does not use it."""
    return [Addressed(Partner(link), message) for link in (GROUND_STATION, COMPANION)]

"""Sequencing of mission items: order, jumps, speeds, actions. Independent of time and position.

Items that take no time are executed when the vehicle reaches them in Mission mode, not before: by `settle`.
"""

from collections import deque

from autopilot.navigation.mission import FLOWN, Mission, MissionCommand, MissionError, MissionItem

_REPORTS = 1_000
"""Greatest number of items that wait to be reported; older ones are dropped."""


class MissionRunner:
    """Steps through a mission's items; keeps its progress while another mode is active."""

    def __init__(self) -> None:
        self.mission: Mission | None = None
        self.current = 0
        """Index of the present item; of the last one when finished."""
        self.reached: int | None = None
        """Index of the last item that was flown."""
        self.reached_count = 0
        """Number of items flown; incremented with every `reached`, also for the same item."""
        self.done: deque[int] = deque(maxlen=_REPORTS)
        """Indices of items flown or executed; the reader reports and removes them."""
        self.begun = False
        """Whether an item was flown or executed since the start."""
        self.finished = False
        self.speed_m_s: float | None = None
        """Speed set by the mission; None: MPC_XY_CRUISE."""
        self.look_at: MissionItem | None = None
        """Region of interest for the heading; None: by other settings."""
        self.version = 0
        """Incremented when another item is to be flown, or the same one again."""
        self._jumps_done: dict[int, int] = {}

    @property
    def item(self) -> MissionItem | None:
        """Present item; None without a mission or when it is finished."""
        if self.mission is None or self.finished:
            return None
        return self.mission.items[self.current]

    def load(self, mission: Mission | None, *, start: int = 0) -> None:
        """Replace the mission, or remove it, and start with its first item or another one."""
        self.mission = mission
        self.restart()
        if start:
            self.set_current(start)

    def restart(self) -> None:
        """Reset the progress and start with the first item."""
        self.reached = None
        self.reached_count = 0
        self.begun = False
        self.done.clear()
        self._jumps_done.clear()
        self._begin(0)

    def set_current(self, index: int) -> None:
        """Continue with another item (MISSION_SET_CURRENT). Raises MissionError if it does not exist.

        Jump counts are reset; speed and region of interest are the last ones set by the items before it.
        """
        count = 0 if self.mission is None else len(self.mission.items)
        if not 0 <= index < count:
            raise MissionError(f"there is no item {index}" if count else "there is no mission")
        self._jumps_done.clear()
        self._begin(index)

    def settle(self) -> None:
        """Execute items that take no time, from the present one up to the first that is flown."""
        item = self.item
        if item is not None and item.command not in FLOWN:
            self._go_on(self.current)

    def advance(self) -> None:
        """Mark the present item as complete and continue with the next one that is flown."""
        if self.item is None:
            return
        self.reached = self.current
        self.reached_count += 1
        self._note(self.current)
        self._go_on(self.current + 1)

    def next_item(self) -> MissionItem | None:
        """Return the item that will be flown after the present one, or None; changes nothing."""
        if self.mission is None or self.finished:
            return None
        index, _ = self._walk(self.current + 1, dict(self._jumps_done))
        return self.mission.items[index] if index < len(self.mission.items) else None

    def _begin(self, index: int) -> None:
        self.version += 1
        self.finished = False
        self.current = index
        self.speed_m_s = self.look_at = None
        for item in self.mission.items[:index] if self.mission is not None else ():
            self._carry_out(item)

    def _go_on(self, index: int) -> None:
        """Continue with the first item from an index that is flown, and execute the items before it."""
        self.version += 1
        items = self.mission.items if self.mission is not None else ()
        index, acts = self._walk(index, self._jumps_done)
        for act in acts:
            self._carry_out(items[act])
            self._note(act)
        self.finished = index >= len(items)
        self.current = min(index, len(items) - 1)

    def _carry_out(self, item: MissionItem) -> None:
        if item.command is MissionCommand.CHANGE_SPEED:
            self.speed_m_s = item.speed_m_s
        elif item.command is MissionCommand.LOOK_AT:
            self.look_at = item
        elif item.command is MissionCommand.LOOK_AHEAD:
            self.look_at = None

    def _note(self, index: int) -> None:
        self.begun = True
        self.done.append(index)

    def _walk(self, index: int, jumps_done: dict[int, int]) -> tuple[int, list[int]]:
        """Return the index of the first item from ``index`` that is flown, and the actions before it.

        Counts the jumps taken. Terminates, because every loop of a `Mission` contains an item that is flown.
        """
        items = self.mission.items if self.mission is not None else ()
        acts: list[int] = []
        while index < len(items) and items[index].command not in FLOWN:
            item = items[index]
            if item.command is not MissionCommand.JUMP:
                acts.append(index)
                index += 1
            elif item.jump_count < 0 or jumps_done.get(index, 0) < item.jump_count:
                jumps_done[index] = jumps_done.get(index, 0) + 1
                index = item.jump_to
            else:
                index += 1
        return index, acts

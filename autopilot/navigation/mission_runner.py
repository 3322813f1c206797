"""Which item of a mission is flown: order, jumps, speeds, acts. It knows no time, and flies to no place.

What is not flown is carried out when a vehicle comes by in Mission mode, not before: `settle` does so.
"""

from collections import deque

from autopilot.navigation.mission import FLOWN, Mission, MissionCommand, MissionError, MissionItem

_REPORTS = 1_000
"""Most items that are kept to be told of; of more, the newest."""


class MissionRunner:
    """Goes through a mission's items; keeps its place while another mode flies."""

    def __init__(self) -> None:
        self.mission: Mission | None = None
        self.current = 0
        """Index of the item that is flown, or would be; of the last one when finished."""
        self.reached: int | None = None
        """Index of the item flown last."""
        self.reached_count = 0
        """How many items were flown: rises with every `reached`, also of the same item."""
        self.done: deque[int] = deque(maxlen=_REPORTS)
        """Indices of items flown or carried out, for whoever tells of them and takes them away."""
        self.begun = False
        """Something was flown or carried out since the beginning."""
        self.finished = False
        self.speed_m_s: float | None = None
        """As the mission changed it; None: MPC_XY_CRUISE."""
        self.look_at: MissionItem | None = None
        """Where the nose is to point; None: where other settings say."""
        self.version = 0
        """Rises whenever the item to be flown is another, or the same one anew."""
        self._jumps_done: dict[int, int] = {}

    @property
    def item(self) -> MissionItem | None:
        """Present item; None without a mission or when it is finished."""
        if self.mission is None or self.finished:
            return None
        return self.mission.items[self.current]

    def load(self, mission: Mission | None, *, start: int = 0) -> None:
        """Take another mission, or none, and begin with its first item, or another that exists."""
        self.mission = mission
        self.restart()
        if start:
            self.set_current(start)

    def restart(self) -> None:
        """Begin with the first item, as if never flown."""
        self.reached = None
        self.reached_count = 0
        self.begun = False
        self.done.clear()
        self._jumps_done.clear()
        self._begin(0)

    def set_current(self, index: int) -> None:
        """Go on with another item (MISSION_SET_CURRENT). Raises MissionError for one that does not exist.

        Jumps begin to count anew; speed and view are the last ones set in the items before it.
        """
        count = 0 if self.mission is None else len(self.mission.items)
        if not 0 <= index < count:
            raise MissionError(f"there is no item {index}" if count else "there is no mission")
        self._jumps_done.clear()
        self._begin(index)

    def settle(self) -> None:
        """Carry out what acts at once from the present item on, and stop at the first that is flown."""
        item = self.item
        if item is not None and item.command not in FLOWN:
            self._go_on(self.current)

    def advance(self) -> None:
        """Note that the present item is done, and take the next that is flown."""
        if self.item is None:
            return
        self.reached = self.current
        self.reached_count += 1
        self._note(self.current)
        self._go_on(self.current + 1)

    def next_item(self) -> MissionItem | None:
        """Item that will be flown after the present one, or None; changes nothing."""
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
        """Take the first item from an index on that is flown, and carry out what is on the way to it."""
        self.version += 1
        items = self.mission.items if self.mission is not None else ()
        index, acts = self._walk(index, self._jumps_done)
        for act in acts:
            self._carry_out(items[act])
            self._note(act)
        self.finished = index >= len(items)
        self.current = min(index, len(items) - 1)

    def _carry_out(self, item: MissionItem) -> None:
        """Keep what an item says of those that follow."""
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
        """Index of the first item from ``index`` on that is flown, and of the acts on the way to it.

        Counts the jumps taken. Ends, for no circle of a `Mission` is without something flown.
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

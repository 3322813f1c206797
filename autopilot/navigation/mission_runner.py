"""Which item of a mission is flown: order, jumps, speeds. It knows no places and no time."""

from autopilot.navigation.mission import FLOWN, Mission, MissionCommand, MissionError, MissionItem


class MissionRunner:
    """Goes through a mission's items; keeps its place while another mode flies."""

    def __init__(self) -> None:
        self.mission: Mission | None = None
        self.current = 0
        """Index of the item that is flown, or would be; of the last one when finished."""
        self.reached: int | None = None
        """Index of the item that was done last, for MISSION_ITEM_REACHED."""
        self.reached_count = 0
        """How many items were done: rises with every `reached`, also of the same item."""
        self.finished = False
        self.speed_m_s: float | None = None
        """As the mission changed it; None: MPC_XY_CRUISE."""
        self.version = 0
        """Rises whenever the item to be flown is another, or the same one anew."""
        self._jumps_done: dict[int, int] = {}

    @property
    def item(self) -> MissionItem | None:
        """Item to be flown; None without a mission or when it is finished."""
        if self.mission is None or self.finished:
            return None
        return self.mission.items[self.current]

    def load(self, mission: Mission | None) -> None:
        """Take another mission, or none, and begin with its first item."""
        self.mission = mission
        self.restart()

    def restart(self) -> None:
        """Begin with the first item, as if never flown."""
        self.reached = None
        self.reached_count = 0
        self._jumps_done.clear()
        self._begin(0)

    def set_current(self, index: int) -> None:
        """Go on with another item (MISSION_SET_CURRENT). Raises MissionError for one that does not exist.

        Jumps begin to count anew, and the speed is the last one set in the items before it.
        """
        count = 0 if self.mission is None else len(self.mission.items)
        if not 0 <= index < count:
            raise MissionError(f"there is no item {index}" if count else "there is no mission")
        self._jumps_done.clear()
        self._begin(index)

    def advance(self) -> None:
        """Note that the present item is done, and take the next."""
        if self.item is None:
            return
        self.reached = self.current
        self.reached_count += 1
        self._settle(self.current + 1)

    def next_item(self) -> MissionItem | None:
        """Item that will be flown after the present one, or None; changes nothing."""
        if self.mission is None or self.finished:
            return None
        index, _ = self._walk(self.current + 1, dict(self._jumps_done))
        return self.mission.items[index] if index < len(self.mission.items) else None

    def _begin(self, index: int) -> None:
        self.finished = False
        self.speed_m_s = None
        for item in self.mission.items[:index] if self.mission is not None else ():
            if item.command is MissionCommand.CHANGE_SPEED:
                self.speed_m_s = item.speed_m_s
        self._settle(index)

    def _settle(self, index: int) -> None:
        """Carry out what acts at once from an index on, and stop at the first item that is flown."""
        self.version += 1
        if self.mission is None:
            self.current, self.finished = 0, False
            return
        index, speeds = self._walk(index, self._jumps_done)
        if speeds:
            self.speed_m_s = speeds[-1]
        self.finished = index >= len(self.mission.items)
        self.current = min(index, len(self.mission.items) - 1)

    def _walk(self, index: int, jumps_done: dict[int, int]) -> tuple[int, list[float | None]]:
        """Index of the first item from ``index`` on that is flown, and the speeds set on the way to it.

        Counts the jumps taken. Ends, for no circle of a `Mission` is without something flown.
        """
        items = self.mission.items if self.mission is not None else ()
        speeds: list[float | None] = []
        while index < len(items) and items[index].command not in FLOWN:
            item = items[index]
            if item.command is MissionCommand.CHANGE_SPEED:
                speeds.append(item.speed_m_s)
                index += 1
            elif item.jump_count < 0 or jumps_done.get(index, 0) < item.jump_count:
                jumps_done[index] = jumps_done.get(index, 0) + 1
                index = item.jump_to
            else:
                index += 1
        return index, speeds

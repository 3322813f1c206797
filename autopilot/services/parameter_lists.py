"""Parameter lists in progress: the next index of each partner's list, and the time of the next batch."""

from autopilot.parameters.table import ROWS
from autopilot.services.service import NEVER_US, Partner
from autopilot.services.shaper import Room, always

LIST_PERIOD_US = 20_000
LIST_BATCH = 16
"""Values per batch: a list takes a third of a second instead of one burst."""
MOST_LISTS = 16
"""Concurrent lists; a new one replaces the oldest."""


class ParameterLists:
    """Parameters that remain to be sent, by partner."""

    def __init__(self, has_room: Room = always) -> None:
        self._has_room = has_room
        self._next_index: dict[Partner, int] = {}
        self.due_us = NEVER_US
        """Time of the next batch."""

    def begin(self, partner: Partner, now_us: int, *, first: int = 0) -> None:
        """Begin a partner's list at index ``first``; one in progress restarts at index 0."""
        if self.end(partner):
            first = 0
        if len(self._next_index) >= MOST_LISTS:
            del self._next_index[next(iter(self._next_index))]
        self._next_index[partner] = first
        self.due_us = min(self.due_us, now_us)

    def end(self, partner: Partner) -> bool:
        """End a partner's list; return whether there was one."""
        return self._next_index.pop(partner, None) is not None

    def next_batch(self, now_us: int) -> list[tuple[Partner, range]]:
        """Return the indices to send now to each partner whose link has room."""
        if now_us < self.due_us:
            return []
        batch: list[tuple[Partner, range]] = []
        for partner, begin in list(self._next_index.items()):
            if not self._has_room(partner):
                continue
            until = min(begin + LIST_BATCH, len(ROWS))
            batch.append((partner, range(begin, until)))
            self._next_index[partner] = until
            if until == len(ROWS):
                del self._next_index[partner]
        self.due_us = now_us + LIST_PERIOD_US if self._next_index else NEVER_US
        return batch

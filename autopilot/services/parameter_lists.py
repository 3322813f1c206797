"""Lists of parameters under way: how far each partner's is, and when the next batch is due."""

from autopilot.parameters.table import ROWS
from autopilot.services.service import NEVER_US, Partner
from autopilot.services.shaper import Room, always

LIST_PERIOD_US = 20_000
LIST_BATCH = 16
"""Values go out in batches, so that a list takes a third of a second and is not one burst."""
MOST_LISTS = 16
"""At a time; the oldest ends for one more."""


class ParameterLists:
    """Rows that are still to be sent, by partner."""

    def __init__(self, has_room: Room = always) -> None:
        self._has_room = has_room
        self._next_index: dict[Partner, int] = {}
        self.due_us = NEVER_US
        """When `next_batch` has something to give."""

    def begin(self, partner: Partner, now_us: int, *, first: int = 0) -> None:
        """Begin a partner's list with the row ``first``, or with row 0 again while one is under way."""
        if self.end(partner):
            first = 0
        if len(self._next_index) >= MOST_LISTS:
            del self._next_index[next(iter(self._next_index))]
        self._next_index[partner] = first
        self.due_us = min(self.due_us, now_us)

    def end(self, partner: Partner) -> bool:
        """Give up a partner's list; tells whether there was one."""
        return self._next_index.pop(partner, None) is not None

    def next_batch(self, now_us: int) -> list[tuple[Partner, range]]:
        """Give the rows that go out now, each partner's on whose link there is room."""
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

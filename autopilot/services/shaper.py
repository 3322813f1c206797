"""A link's budget of bytes a second: what goes out at once, what waits, and what is left out.

A token bucket per link, in simulated time. Answers go out always, and what they take is missing afterwards.
Of what is left, transfers that somebody waits for (a parameter list, a file, a log) get three parts of four
while there are any; streams get the rest. A stream's message that must wait is replaced by the next of its
kind and keeps its place, so that slow streams are not crowded out by fast ones: each gets its turn.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message, frame_bytes
from autopilot.services.service import Addressed, Partner

FILES = frozenset(
    {
        common.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL,
        common.MAVLINK_MSG_ID_LOG_ENTRY,
        common.MAVLINK_MSG_ID_LOG_DATA,
    }
)
"""Parts of transfers whether they were asked for one by one or not."""
LISTS = frozenset({common.MAVLINK_MSG_ID_PARAM_VALUE, common.MAVLINK_MSG_ID_PARAM_EXT_VALUE})
"""Parts of transfers if they come by themselves."""
TRANSFER_SHARE = 3
"""Bytes of transfers for each byte of streams, while there are both."""
BURST_US = 100_000
"""What a link may send at once after a silence: its budget of so much time."""
MOST_DEBT_US = 1_000_000
"""Answers are not owed for longer than this."""
MAX_WAITING = 64
"""Messages of transfers; what comes then is lost, and is asked for again. Services that ask `has_room` before
they send more never come so far."""
_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
_US_PER_S = 1_000_000

Room = Callable[[Partner], bool]
"""Whether a partner's link has room for more of what takes long."""


def always(_partner: Partner) -> bool:
    """On a link without a limit."""
    return True


class Shaper:
    """One link's budget. Every message counts in full, whomever on the link it is for."""

    def __init__(self, bandwidth_bytes_s: int, *, overhead_bytes: int = 0) -> None:
        """``overhead_bytes`` is what each frame takes beside itself: a signature."""
        self._bandwidth_bytes_s = bandwidth_bytes_s
        self._overhead_bytes = overhead_bytes
        self._tokens = 0
        """Bytes times us per second, that may be sent now; below zero they were sent already."""
        self._earned_us: int | None = None
        self._transfers: deque[tuple[Addressed, int]] = deque()
        """Each with its bytes."""
        self._transfer_bytes = 0
        self._streams: dict[int, Addressed] = {}
        """By kind, in the order of their turns."""
        self._lead_bytes = 0
        """How far transfers are ahead of their share."""
        self.limited = 0
        """Messages that were left out."""

    def shape(
        self,
        now_us: int,
        *,
        answers: Iterable[Addressed] = (),
        transfers: Iterable[Addressed] = (),
        streams: Iterable[Addressed] = (),
    ) -> list[Addressed]:
        """Give what goes out now: all answers, and what the budget has room for of all that waits."""
        self._earn(now_us)
        out = list(answers)
        for addressed in streams:
            kind = addressed.message.get_msgId()
            if kind == _HEARTBEAT:
                out.append(addressed)
                continue
            self.limited += kind in self._streams
            self._streams[kind] = addressed
        for addressed in out:
            self._spend(self._bytes(addressed.message))
        self._tokens = max(self._tokens, -self._bandwidth_bytes_s * MOST_DEBT_US)
        for addressed in transfers:
            self._queue(addressed)
        while self._tokens > 0 and (self._transfers or self._streams):
            out.append(self._next())
        return out

    def has_room(self) -> bool:
        """Whether one more message of a transfer would go out soon; who can wait for that loses nothing."""
        return self._transfer_bytes * _US_PER_S <= self._bandwidth_bytes_s * BURST_US

    def _earn(self, now_us: int) -> None:
        passed_us = 0 if self._earned_us is None else now_us - self._earned_us
        self._earned_us = now_us
        budget = self._bandwidth_bytes_s
        self._tokens = min(self._tokens + budget * passed_us, budget * BURST_US)

    def _spend(self, count: int) -> None:
        self._tokens -= count * _US_PER_S

    def _queue(self, addressed: Addressed) -> None:
        if len(self._transfers) >= MAX_WAITING:
            self.limited += 1
            return
        count = self._bytes(addressed.message)
        self._transfers.append((addressed, count))
        self._transfer_bytes += count

    def _next(self) -> Addressed:
        """Take the next message by the shares, and pay for it."""
        if not (self._transfers and self._streams):
            self._lead_bytes = 0
        if self._transfers and (self._lead_bytes <= 0 or not self._streams):
            addressed, count = self._transfers.popleft()
            self._transfer_bytes -= count
            self._lead_bytes += count
        else:
            addressed = self._streams.pop(next(iter(self._streams)))
            count = self._bytes(addressed.message)
            self._lead_bytes -= TRANSFER_SHARE * count
        self._spend(count)
        return addressed

    def _bytes(self, message: Message) -> int:
        return frame_bytes(message) + self._overhead_bytes


class Shapers:
    """The budgets of a vehicle's links; without a limit there are none, and nothing is looked at."""

    def __init__(self, links: Sequence[int], bandwidth_bytes_s: int, *, overhead_bytes: int = 0) -> None:
        self._shapers = (
            {link: Shaper(bandwidth_bytes_s, overhead_bytes=overhead_bytes) for link in links}
            if bandwidth_bytes_s
            else {}
        )

    def __bool__(self) -> bool:
        """Whether there is a limit."""
        return bool(self._shapers)

    def shape(
        self,
        now_us: int,
        *,
        answered: Sequence[Addressed],
        timed: Sequence[Addressed],
        streamed: Sequence[Addressed],
    ) -> list[Addressed]:
        """Give what goes out of a step's answers, of what services sent by themselves, and of streams."""
        out: list[Addressed] = []
        for link, shaper in self._shapers.items():
            answers: list[Addressed] = []
            transfers: list[Addressed] = []
            for messages, kinds in ((answered, FILES), (timed, FILES | LISTS)):
                for addressed in messages:
                    if addressed.partner.link == link:
                        is_transfer = addressed.message.get_msgId() in kinds
                        (transfers if is_transfer else answers).append(addressed)
            streams = [addressed for addressed in streamed if addressed.partner.link == link]
            out += shaper.shape(now_us, answers=answers, transfers=transfers, streams=streams)
        return out

    def has_room(self, partner: Partner) -> bool:
        """Whether one more message of a transfer to this partner would go out soon."""
        shaper = self._shapers.get(partner.link)
        return shaper is None or shaper.has_room()

    def limited(self, link: int) -> int:
        """Messages of a link that were left out."""
        shaper = self._shapers.get(link)
        return 0 if shaper is None else shaper.limited

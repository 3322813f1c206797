"""Bandwidth limit of a link: which messages are sent at once, which wait, and which are dropped.

One token bucket per link, in simulated time. Answers are always sent, and their bytes are charged. Of the
rest, transfers (parameter lists, files, logs) get three quarters while there are any, and streams get the
remainder. A waiting message of a stream is replaced by the next of its kind and keeps its position, so slow
streams are not starved by fast ones.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

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
"""Part of a transfer, whether sent as an answer or by a timer."""
LISTS = frozenset({common.MAVLINK_MSG_ID_PARAM_VALUE, common.MAVLINK_MSG_ID_PARAM_EXT_VALUE})
"""Part of a transfer only if sent by a timer."""
TRANSFER_SHARE = 3
"""Bytes of transfers per byte of streams, while there are both."""
BURST_US = 100_000
"""Largest burst after a silence, as time at the full rate."""
MOST_DEBT_US = 1_000_000
"""Largest debt due to answers, as time at the full rate."""
MAX_WAITING = 64
"""Waiting messages of transfers; further ones, from services that do not check `has_room`, are dropped."""
_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
_US_PER_S = 1_000_000

Room = Callable[[Partner], bool]
"""Whether a partner's link has room for more messages of transfers."""


def always(_partner: Partner) -> bool:
    """Return True, as on a link without a limit."""
    return True


class Shaper:
    """One link's budget. Every message is charged in full, whichever partner on the link it is for."""

    def __init__(self, bandwidth_bytes_s: int, *, overhead_bytes: int = 0) -> None:
        """``overhead_bytes`` are added to each frame: the signature."""
        self._bandwidth_bytes_s = bandwidth_bytes_s
        self._overhead_bytes = overhead_bytes
        self._tokens = 0
        """Bytes times us per second that may be sent now; negative: a debt."""
        self._earned_us: int | None = None
        self._transfers: deque[tuple[Addressed, int]] = deque()
        """Waiting messages with their bytes."""
        self._transfer_bytes = 0
        self._streams: dict[int, Addressed] = {}
        """Waiting messages by message id, in the order in which they will be sent."""
        self._lead_bytes = 0
        """Bytes that transfers are ahead of their share."""
        self.limited = 0
        """Count of dropped messages."""

    def shape(
        self,
        now_us: int,
        *,
        answers: Iterable[Addressed] = (),
        transfers: Iterable[Addressed] = (),
        streams: Iterable[Addressed] = (),
    ) -> list[Addressed]:
        """Return the messages to send now: all answers, and as many waiting ones as the budget permits."""
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
        """Whether one more message of a transfer would be sent soon; callers should wait if not."""
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
        """Remove the next message according to the shares, and charge its bytes."""
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
    """The budgets of a vehicle's links; empty, and without any cost, if there is no limit.

    ``bandwidths_bytes_s`` are the limits by link; 0: none.
    """

    def __init__(self, bandwidths_bytes_s: Mapping[int, int], *, overhead_bytes: int = 0) -> None:
        self._shapers = {
            link: Shaper(bandwidth_bytes_s, overhead_bytes=overhead_bytes)
            for link, bandwidth_bytes_s in bandwidths_bytes_s.items()
            if bandwidth_bytes_s
        }

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
        """Return what to send of a step's answers, messages sent by timers, and streams."""
        out = [
            addressed
            for messages in (answered, timed, streamed)
            for addressed in messages
            if addressed.partner.link not in self._shapers
        ]
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
        """Whether one more message of a transfer to this partner would be sent soon."""
        shaper = self._shapers.get(partner.link)
        return shaper is None or shaper.has_room()

    def limited(self, link: int) -> int:
        """Count of a link's dropped messages."""
        shaper = self._shapers.get(link)
        return 0 if shaper is None else shaper.limited

"""MAVLink's log download: the list of logs, and their bytes in pieces of 90 from a requested offset on.

The station requests lost pieces again. Erasing is refused: the log is part of the run's record.
"""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.files import FileStore, Readable
from autopilot.services.service import NEVER_US, Addressed, Newest, Partner, Service, reply
from autopilot.services.shaper import Room, always
from autopilot.services.status import status_text

PIECE_BYTES = 90
SEND_PERIOD_US = 4_000
PIECES = 8
"""Pieces per period: 180 kB/s."""
MOST_DOWNLOADS = 8
"""Concurrent downloads; a new one replaces the oldest."""
_LARGEST = 2**32 - 1


class _Download:
    def __init__(self, number: int, file: Readable, offset: int, count: int) -> None:
        self.number = number
        self.file = file
        self.offset = offset
        self.left = max(min(count, file.size() - offset), 0)

    def next_piece(self) -> Message:
        """LOG_DATA; a piece that is not full is the last of a log."""
        data = self.file.read(self.offset, min(self.left, PIECE_BYTES)) if self.left else b""
        padded = data.ljust(PIECE_BYTES, b"\0")
        message = common.MAVLink_log_data_message(self.number, self.offset, len(data), padded)
        self.offset += len(data)
        self.left = self.left - len(data) if data else 0
        return message


class LogService(Service):
    """Log list and downloads for the partners of all links."""

    def __init__(self, files: FileStore, has_room: Room = always) -> None:
        super().__init__(
            LOG_REQUEST_LIST=self._list, LOG_REQUEST_DATA=self._begin, LOG_REQUEST_END=lambda *_: (),
            LOG_ERASE=_refuse_erase,
        )  # fmt: skip
        self._files = files
        self._has_room = has_room
        self._downloads: Newest[Partner, _Download] = Newest(MOST_DOWNLOADS)

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Answer a request, which ends the partner's download; log data is sent by `on_timer`."""
        self._downloads.pop(partner, None)
        return super().on_message(message, now_us, partner)

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Send the next pieces."""
        if now_us < self.due_us:
            return ()
        messages: list[Addressed] = []
        for partner, download in list(self._downloads.items()):
            for _ in range(PIECES if self._has_room(partner) else 0):
                messages += reply(partner, download.next_piece())
                if not download.left:
                    del self._downloads[partner]
                    break
        self.due_us = now_us + SEND_PERIOD_US if self._downloads else NEVER_US
        return messages

    def _list(self, message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        """LOG_ENTRY of each log in a range of numbers, or the entry that reports an empty list."""
        logs = self._files.logs
        if not logs:
            return reply(partner, common.MAVLink_log_entry_message(0, 0, 0, 0, 0))
        first, last = min(message.start, len(logs) - 1), min(message.end, len(logs) - 1)
        return reply(partner, *(
            common.MAVLink_log_entry_message(
                number, len(logs), last, logs[number].time_utc_s, min(logs[number].file.size(), _LARGEST)
            )
            for number in range(first, last + 1)
        ))  # fmt: skip

    def _begin(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        logs = self._files.logs
        if message.id < len(logs):
            file = logs[message.id].file
            self._downloads[partner] = _Download(message.id, file, message.ofs, message.count)
            self.due_us = min(self.due_us, now_us)
        return ()


def _refuse_erase(_message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
    text = "Log erase denied: part of the run's record"
    return reply(partner, status_text(common.MAV_SEVERITY_WARNING, text))

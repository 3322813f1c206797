"""MAVLink's mission protocol: stations write, read and clear missions, fences and rally points.

One plan is written at a time, atomically: the vehicle requests item after item, and replaces the old plan
only when all items have arrived and passed the checks. Any station may read at any time. Behaviour is PX4's
(mavlink_mission.cpp), except where that fails on a link that loses, duplicates and reorders messages:

- Late copies of MISSION_COUNT and of items are ignored; PX4 answers them with an error.
- On a late copy of a request, MAVSDK returns to that item and ignores requests for items beyond it. So after
  unanswered requests the vehicle repeats from an earlier item.
- The last acknowledgement is repeated while the station is silent: MAVSDK and QGroundControl only wait.
- While simulated time is paused no upload can time out. An upload whose station was silent between two
  attempts of another station is replaced by the other's, and a station may restart its own.
- Concurrent reads are allowed, in any order of items. PX4 serves one reader at a time, items in order.
"""

from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import MissionCount, by_id
from autopilot.navigation.plan_store import CAPACITY, Made, PlanStore, PlanType, Refused, WireItem
from autopilot.services.plan_upload import (
    COPY_US,
    MOST_BACK,
    PATIENT_RETRIES,
    REPEAT_US,
    RETRY_US,
    STALE_US,
    TIMEOUT_US,
    Upload,
    UploadStation,
)
from autopilot.services.plan_wire import decode_item, encode_item
from autopilot.services.service import ALL, NEVER_US, Addressed, Newest, Partner, reply
from autopilot.services.status import status_text

_MAX_READERS = 32

_ACCEPTED = common.MAV_MISSION_ACCEPTED
_ERROR = common.MAV_MISSION_ERROR

Make = Callable[[PlanType, Sequence[WireItem]], Made | Refused]


class PlanTransfer:
    """The plans of a vehicle, and the transfers with all stations."""

    def __init__(
        self,
        store: PlanStore,
        *,
        make: Make,
        system: int,
        current: Callable[[], int] = lambda: 0,
        time_stands: Callable[[], bool] = lambda: False,
    ) -> None:
        """Store uploaded items, and the result of ``make`` for them unless it refuses them.

        ``current`` returns the index of the current mission item. ``system`` is the vehicle's system id;
        messages to system 0 (broadcast) are ignored, as in PX4. ``time_stands`` returns whether simulated
        time is paused, so that messages arrive between two steps.
        """
        self._store = store
        self._make = make
        self._system = system
        self._current = current
        self._time_stands = time_stands
        self._upload: Upload | None = None
        self._finished: Upload | None = None
        self._cleared: tuple[UploadStation, int, int] | None = None
        """Station that last cleared a plan, the MAV_MISSION_TYPE, and the time"""
        self._readers: Newest[tuple[UploadStation, PlanType], int] = Newest(_MAX_READERS)
        """Versions of the plans that stations have begun to read, in the order of the first request."""
        self._handlers = by_id(
            MISSION_COUNT=self._on_count, MISSION_WRITE_PARTIAL_LIST=self._on_partial_write,
            MISSION_ITEM=self._on_item, MISSION_ITEM_INT=self._on_item,
            MISSION_REQUEST_LIST=self._on_list, MISSION_REQUEST_PARTIAL_LIST=self._on_partial_list,
            MISSION_REQUEST=self._on_request, MISSION_REQUEST_INT=self._on_request,
            MISSION_ACK=self._on_ack, MISSION_CLEAR_ALL=self._on_clear,
        )  # fmt: skip
        self.takes = frozenset(self._handlers)

    @property
    def receiving(self) -> bool:
        """Whether a plan is being written."""
        return self._upload is not None

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Handle a message of a transfer and return the answers."""
        if message.target_system != self._system:
            return ()
        station = UploadStation(partner, message.get_srcSystem(), message.get_srcComponent())
        finished, upload = self._finished, self._upload
        if finished is not None and station == finished.station and not finished.is_late_item(message):
            finished.repeats_us = []  # the station has gone on, so it has received the acknowledgement
        if upload is not None and station == upload.station:
            upload.refused = None
        return self._handlers[message.get_msgId()](message, now_us, station)

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Repeat requests and acknowledgements that are due, and end an upload that timed out."""
        messages: list[Addressed] = []
        finished, upload = self._finished, self._upload
        if finished is not None and finished.repeats_us and now_us >= finished.repeats_us[0]:
            del finished.repeats_us[0]
            messages += finished.answer
        if upload is not None and now_us - upload.heard_us >= TIMEOUT_US:
            self._upload = None
            messages += _broadcast_text("Operation timeout")
        elif upload is not None and now_us >= upload.retry_us:
            messages += self._request_again(upload, now_us)
        return messages

    def next_deadline_us(self) -> int:
        """Time of the next repetition or timeout."""
        deadline_us = NEVER_US
        if self._upload is not None:
            deadline_us = min(self._upload.retry_us, self._upload.heard_us + TIMEOUT_US)
        if self._finished is not None and self._finished.repeats_us:
            deadline_us = min(deadline_us, self._finished.repeats_us[0])
        return deadline_us

    # ---- writing

    def _on_count(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """Begin to receive a whole plan; an empty one is complete at once."""
        return self._on_begin(message, range(message.count), now_us, station, is_partial=False)

    def _on_partial_write(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """Begin to receive a range of a plan's items, which may extend past its end."""
        span = range(message.start_index, message.end_index + 1)
        return self._on_begin(message, span, now_us, station, is_partial=True)

    def _on_begin(
        self, message: Message, span: range, now_us: int, station: UploadStation, *, is_partial: bool
    ) -> Sequence[Addressed]:
        rejection = self._rejection(message, span, now_us, station)
        if rejection is not None:
            return rejection
        self._upload = None
        kind = _plan_type(message.mission_type)
        if kind is None:
            return station.acknowledge(message.mission_type, common.MAV_MISSION_UNSUPPORTED)
        before = self._store[kind] if is_partial else None
        if before is not None and (not span or not 0 <= span.start <= len(before.items)):
            return station.acknowledge(kind, common.MAV_MISSION_INVALID_SEQUENCE)
        if span.stop > CAPACITY[kind]:
            return station.acknowledge(kind, common.MAV_MISSION_NO_SPACE)
        if not span:
            self._store.put(kind, ())
            return station.acknowledge(kind, _ACCEPTED)
        upload = self._upload = Upload(
            station=station,
            kind=kind,
            span=span,
            before=before,
            start=0 if before is None else before.start,
            asked=span.start,
            asked_us=now_us,
            retry_us=now_us + RETRY_US,
            heard_us=now_us,
            stray=span.stop,
        )
        return upload.request(span.start)

    def _rejection(
        self, message: Message, span: range, now_us: int, station: UploadStation
    ) -> Sequence[Addressed] | None:
        """Answer, possibly empty, to a station that must not begin an upload now; None if it may."""
        upload, finished = self._upload, self._finished
        if upload is None:
            return None
        if upload.station != station:
            return self._refusal(upload, message, station)
        if self._time_stands():
            return None
        requested = (message.mission_type, span)
        late = (upload.kind, upload.span) == requested and bool(upload.items)
        late = late and now_us - upload.heard_us < STALE_US
        if finished is not None and finished.station == station and now_us - finished.ended_us < STALE_US:
            late = late or (finished.kind, finished.span) == requested
        return () if late else None

    def _refusal(
        self, upload: Upload, message: Message, station: UploadStation
    ) -> Sequence[Addressed] | None:
        """Answer to a station other than the uploading one; None if that upload counts as abandoned."""
        if self._time_stands() and upload.refused == station:
            return None
        upload.refused = station
        return station.acknowledge(message.mission_type, _ERROR)

    def _on_item(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        upload, seq = self._upload, message.seq
        if upload is None:
            return self._on_unrequested_item(message, now_us, station)
        if station != upload.station or message.mission_type != upload.kind:
            return ()  # late, or from a station that was refused
        upload.heard_us = now_us
        upload.in_integers = message.get_msgId() == common.MAVLINK_MSG_ID_MISSION_ITEM_INT
        if seq not in {upload.missing, upload.asked}:
            upload.stray, upload.stray_us = seq, now_us
            return ()
        if seq == upload.missing:
            upload.items.append(decode_item(message))
            upload.start = seq if message.current else upload.start
        if not upload.retries:
            upload.measure_round(now_us - upload.asked_us)
        upload.retries = 0
        upload.asked_us, upload.retry_us = now_us, now_us + upload.patience_us
        return upload.request(seq + 1) if seq + 1 in upload.span else self._complete(upload, now_us)

    def _on_unrequested_item(
        self, message: Message, now_us: int, station: UploadStation
    ) -> Sequence[Addressed]:
        """Answer as PX4 does, except to late copies: a station that has the result expects no error."""
        finished = self._finished
        if finished is None or station != finished.station:
            return station.acknowledge(message.mission_type, _ERROR)
        if finished.repeats_us or now_us - finished.ended_us < STALE_US:
            return ()
        if message.seq == finished.span[-1] and finished.is_late_item(message):
            return finished.answer
        return station.acknowledge(message.mission_type, _ERROR)

    def _request_again(self, upload: Upload, now_us: int) -> Sequence[Addressed]:
        """Request the missing item, or an earlier one if the station appears to have returned to it."""
        upload.retries += 1
        upload.retry_us = now_us + upload.patience_us
        seq = upload.asked
        went_back = max(upload.span.start, seq - MOST_BACK) <= upload.stray + 1 < seq
        if went_back and now_us - upload.stray_us < STALE_US:
            seq, upload.stray = upload.stray + 1, upload.span[-1]
        elif upload.retries > PATIENT_RETRIES and upload.retries % 2:
            seq = max(upload.span.start, seq - 1)
            if not upload.items:  # an old station supports one kind of request only
                upload.in_integers = not upload.in_integers
        return upload.request(seq)

    def _complete(self, upload: Upload, now_us: int) -> Sequence[Addressed]:
        """Check all items as one plan, then store it or keep the old one."""
        self._upload = None
        station, kind, before = upload.station, upload.kind, upload.before
        items = upload.items
        if before is not None:
            items = [*before.items[: upload.span.start], *items, *before.items[upload.span.stop :]]
        made = self._make(kind, items)
        if isinstance(made, Refused):
            answer, text = station.acknowledge(kind, made.result), _broadcast_text(made.text)
        else:
            self._store.put(kind, items, start=upload.start, made=made)
            answer, text = station.acknowledge(kind, _ACCEPTED, self._store[kind].opaque_id), []
        self._finish(upload, answer, now_us)
        return [*answer, *text]

    def _finish(self, upload: Upload, answer: Sequence[Addressed], now_us: int) -> None:
        self._upload, self._finished = None, upload
        upload.ended_us, upload.answer, upload.items = now_us, answer, []
        upload.repeats_us = [now_us + after_us for after_us in REPEAT_US] if answer else []

    # ---- reading: stateless apart from plan versions, since the reader requests each item

    def _on_list(self, message: Message, _now_us: int, station: UploadStation) -> Sequence[Addressed]:
        kind = _plan_type(message.mission_type)
        if kind is None:  # as PX4: a plan that is empty
            count, opaque_id = 0, 0
        else:
            count, opaque_id = len(self._store[kind].items), self._store[kind].opaque_id
            self._readers[station, kind] = self._store.version[kind]
        return reply(
            station.partner,
            MissionCount(station.system, station.component, count, message.mission_type, opaque_id),
        )

    def _on_partial_list(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """Answer as to a whole list: items keep their numbers, and the station requests those it needs."""
        kind = _plan_type(message.mission_type)
        count = 0 if kind is None else len(self._store[kind].items)
        last = count - 1 if message.end_index == -1 else message.end_index
        if not 0 <= message.start_index <= last < count:
            return station.acknowledge(message.mission_type, common.MAV_MISSION_INVALID_SEQUENCE)
        return self._on_list(message, now_us, station)

    def _on_request(self, message: Message, _now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """Send an item, in the kind of message that was requested.

        Any order is accepted; PX4 requires ascending order. A reader whose plan was replaced meanwhile
        receives an error, upon which it starts again.
        """
        kind, seq = _plan_type(message.mission_type), message.seq
        if kind is None:
            return ()
        version = self._readers.get((station, kind))
        in_range = seq < len(self._store[kind].items)
        if version is None and not in_range:
            return ()  # as PX4: some stations never stop requesting
        if not in_range or version not in {None, self._store.version[kind]}:
            return station.acknowledge(kind, _ERROR)
        item = encode_item(
            self._store[kind].items[seq],
            kind=kind,
            seq=seq,
            current=kind is PlanType.MISSION and seq == self._current(),
            target=(station.system, station.component),
            in_integers=message.get_msgId() == common.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        )
        return reply(station.partner, item)

    # ---- both

    def _on_ack(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """End a read. During an upload: end it if cancelled, or switch to the other kind of request."""
        kind, upload = _plan_type(message.mission_type), self._upload
        if kind is not None:
            self._readers.pop((station, kind), None)
        if upload is None or station != upload.station or kind is not upload.kind:
            return ()
        upload.heard_us = now_us
        if message.type == common.MAV_MISSION_OPERATION_CANCELLED:
            self._finish(upload, (), now_us)
        elif message.type == common.MAV_MISSION_UNSUPPORTED:
            upload.in_integers = not upload.in_integers
            return upload.request(upload.asked)
        return ()

    def _on_clear(self, message: Message, now_us: int, station: UploadStation) -> Sequence[Addressed]:
        """Clear one plan or all; a late copy does not abort the upload that its station has begun since."""
        upload = self._upload
        if upload is not None and station != upload.station:
            refusal = self._refusal(upload, message, station)
            if refusal is not None:
                return refusal
        kind = _plan_type(message.mission_type)
        if kind is None and message.mission_type != common.MAV_MISSION_TYPE_ALL:
            return station.acknowledge(message.mission_type, common.MAV_MISSION_UNSUPPORTED)
        cleared, self._cleared = self._cleared, (station, message.mission_type, now_us)
        if self._upload is not None:
            if cleared is not None and cleared[:2] == self._cleared[:2] and now_us - cleared[2] < COPY_US:
                return ()
            self._finish(self._upload, (), now_us)
        for emptied in PlanType if kind is None else (kind,):
            self._store.put(emptied, ())
        return station.acknowledge(message.mission_type, _ACCEPTED)


def _plan_type(number: int) -> PlanType | None:
    return PlanType(number) if number in _PLAN_TYPES else None


def _broadcast_text(text: str) -> list[Addressed]:
    return reply(ALL, status_text(common.MAV_SEVERITY_CRITICAL, text))


_PLAN_TYPES = frozenset(PlanType)

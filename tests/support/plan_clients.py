"""Models of the mission protocol in MAVSDK, QGroundControl and MAVProxy: states, time-outs and retries.

Modelled on MAVSDK's mavlink_mission_transfer_client.cpp, QGroundControl's PlanManager.cc and MAVProxy's
mission_item_protocol.py, including which fields of an answer they check. A client runs its jobs one after the
other, without a pause by default, and records the result of each.
"""

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import MissionAck, MissionCount
from autopilot.navigation.plan_store import PlanType, WireItem
from autopilot.services.plan_wire import decode_item, encode_item
from autopilot.services.service import NEVER_US

VEHICLE = (1, 1)
COUNT, ACK = common.MAVLINK_MSG_ID_MISSION_COUNT, common.MAVLINK_MSG_ID_MISSION_ACK
ITEM, ITEM_INT = common.MAVLINK_MSG_ID_MISSION_ITEM, common.MAVLINK_MSG_ID_MISSION_ITEM_INT
REQUEST, REQUEST_INT = common.MAVLINK_MSG_ID_MISSION_REQUEST, common.MAVLINK_MSG_ID_MISSION_REQUEST_INT
ACCEPTED = common.MAV_MISSION_ACCEPTED


def bits(items: Iterable[WireItem]) -> list[bytes]:
    """Bytes that distinguish items, NaNs included."""
    return [
        struct.pack("<HBB4fiif", i.command, i.frame, i.autocontinue, *i.params, i.x, i.y, i.z) for i in items
    ]


def drawn_plan(count: int, seed: int = 1) -> tuple[WireItem, ...]:
    """Items with random values in all fields."""
    rng = np.random.default_rng(seed)

    def number():
        return math.nan if rng.random() < 0.2 else float(np.float32(rng.normal(0.0, 100.0)))

    return tuple(
        WireItem(
            command=int(rng.integers(0, 65_536)),
            frame=int(rng.integers(0, 256)),
            params=(number(), number(), number(), number()),
            x=int(rng.integers(-(2**31), 2**31)),
            y=int(rng.integers(-(2**31), 2**31)),
            z=number(),
            autocontinue=int(rng.integers(0, 2)),
        )
        for _ in range(count)
    )


@dataclass
class Job:
    """A task of a client, and its result."""

    does: str
    """ "up", "down" or "clear" """
    kind: PlanType = PlanType.MISSION
    items: Sequence[WireItem] = ()
    """Items to write"""
    result: str = ""
    """ "success", or the reason of a failure; empty while it runs"""
    got: list[WireItem] = field(default_factory=list)
    """Items read"""
    current: int | None = None
    """Number of the item read that was marked as current"""


class Client(ABC):
    """Common parts of the models."""

    PAUSE_US = 0
    """Pause before the next job with a plan of the same kind"""

    def __init__(self, *jobs: Job) -> None:
        self.jobs = jobs
        self.job: Job | None = None
        self.due_us = NEVER_US
        self._waiting = list(jobs)
        self._out: list[Message] = []
        self._begun = False
        self._pausing = False

    @property
    def done(self) -> bool:
        return self._begun and self.job is None and not self._waiting

    def next_deadline_us(self) -> int:
        return self.due_us if self._begun else 0

    def on_timer(self, now_us: int) -> list[Message]:
        if self._pausing:
            self._pausing = False
            self._next(now_us)
        elif self._begun:
            self.due_us = NEVER_US
            self._time_out(now_us)
        else:
            self._begun = True
            self._next(now_us)
        return self._flush()

    def on_message(self, message: Message, now_us: int) -> list[Message]:
        if self.job is not None:
            self._take(message, now_us)
        return self._flush()

    def _flush(self) -> list[Message]:
        out, self._out = self._out, []
        return out

    def _next(self, now_us: int) -> None:
        self.job = self._waiting.pop(0) if self._waiting else None
        self.due_us = NEVER_US
        if self.job is not None:
            self._start(now_us)

    def _end(self, result: str, now_us: int) -> None:
        self.job.result = result
        if self.PAUSE_US and self._waiting and self._waiting[0].kind == self.job.kind:
            self.job, self._pausing, self.due_us = None, True, now_us + self.PAUSE_US
        else:
            self._next(now_us)

    @abstractmethod
    def _start(self, now_us: int) -> None: ...

    @abstractmethod
    def _take(self, message: Message, now_us: int) -> None: ...

    @abstractmethod
    def _time_out(self, now_us: int) -> None: ...

    # ---- messages of all models

    def _say_count(self) -> None:
        self._out.append(MissionCount(*VEHICLE, len(self.job.items), int(self.job.kind)))

    def _say_item(self, seq: int, *, in_integers: bool = True) -> None:
        job = self.job
        self._out.append(
            encode_item(
                job.items[seq],
                kind=job.kind,
                seq=seq,
                current=seq == 0,
                target=VEHICLE,
                in_integers=in_integers,
            )
        )

    def _ask_list(self) -> None:
        self._out.append(common.MAVLink_mission_request_list_message(*VEHICLE, int(self.job.kind)))

    def _ask_item(self, seq: int) -> None:
        self._out.append(common.MAVLink_mission_request_int_message(*VEHICLE, seq, int(self.job.kind)))

    def _say_clear(self) -> None:
        self._out.append(common.MAVLink_mission_clear_all_message(*VEHICLE, int(self.job.kind)))

    def _acknowledge(self, result: int = ACCEPTED) -> None:
        self._out.append(MissionAck(*VEHICLE, result, int(self.job.kind)))

    def _keep(self, message: Message) -> None:
        if message.current:
            self.job.current = message.seq
        self.job.got.append(decode_item(message))


class Mavsdk(Client):
    """MAVSDK: repeats MISSION_COUNT, but sends items only on request; accepts any MISSION_ACK."""

    WAIT_US, RETRIES = 500_000, 5

    def _start(self, now_us: int) -> None:
        self._next_seq = self._tries = self._expected = 0
        self._begins = True
        self._time_out(now_us)

    def _time_out(self, now_us: int) -> None:
        if self._tries >= self.RETRIES:
            self._end("timeout", now_us)
            return
        self._tries += 1
        self.due_us = now_us + self.WAIT_US
        does = self.job.does
        if does == "clear":
            self._say_clear()
        elif does == "up":
            if self._begins:
                self._say_count()
        elif self._begins:
            self._ask_list()
        else:
            self._ask_item(self._next_seq)

    def _take(self, message: Message, now_us: int) -> None:
        kind, does = message.get_msgId(), self.job.does
        if does == "up" and kind == REQUEST:
            self._acknowledge(common.MAV_MISSION_UNSUPPORTED)
            self.due_us = now_us + self.WAIT_US
        elif does == "up" and kind == REQUEST_INT:
            self._on_request(message.seq, now_us)
        elif does == "up" and kind == ACK:
            complete = message.type == ACCEPTED and self._next_seq == len(self.job.items)
            self._end("success" if complete else f"acknowledged {message.type}", now_us)
        elif does == "clear" and kind == ACK:
            self._end("success" if message.type == ACCEPTED else f"acknowledged {message.type}", now_us)
        elif does == "down" and kind == COUNT:
            self._on_count(message.count, now_us)
        elif does == "down" and kind == ITEM_INT:
            self._on_item(message, now_us)

    def _on_request(self, seq: int, now_us: int) -> None:
        self._begins = False
        if self._next_seq < seq:
            return
        if self._next_seq == seq:
            self._tries = 0
        elif self._tries >= self.RETRIES:
            self._end("the same item requested too often", now_us)
            return
        self.due_us = now_us + self.WAIT_US
        self._next_seq = seq
        if seq < len(self.job.items):
            self._say_item(seq)
            self._next_seq += 1
            self._tries += 1

    def _on_count(self, count: int, now_us: int) -> None:
        if count == 0:
            self._acknowledge()
            self._end("success", now_us)
            return
        self.due_us = now_us + self.WAIT_US
        self._begins, self._next_seq, self._tries, self._expected = False, 0, 1, count
        self._ask_item(0)

    def _on_item(self, message: Message, now_us: int) -> None:
        self.due_us = now_us + self.WAIT_US
        if message.seq != self._next_seq:
            return
        self._keep(message)
        self._next_seq += 1
        if self._next_seq == self._expected:
            self._acknowledge()
            self._end("success", now_us)
        else:
            self._tries = 1
            self._ask_item(self._next_seq)


class QGroundControl(Client):
    """QGroundControl: checks the plan type of all answers; during an upload it times out only once."""

    WAIT_US, RETRY_US, RETRIES = 1_500_000, 250_000, 5
    PAUSE_US = 3_000_000
    """Missions, fences and rally points follow each other at once; the user starts the next of a kind."""

    def _start(self, now_us: int) -> None:
        self._tries = 0
        self._expects = 0  # no message has this id
        self._left = list(range(len(self.job.items)))
        self._again(now_us)

    def _again(self, now_us: int) -> None:
        does = self.job.does
        if does == "clear":
            self._say_clear()
            self._expect(ACK, now_us)
        elif does == "up":
            self._say_count()
            self._expect(REQUEST, now_us)
        elif self._expects == ITEM:
            self._ask_item(self._left[0])
            self._expect(ITEM, now_us)
        else:
            self._ask_list()
            self._expect(COUNT, now_us)

    def _expect(self, kind: int, now_us: int) -> None:
        self._expects = kind
        self.due_us = now_us + (self.RETRY_US if kind == ITEM else self.WAIT_US)

    def _time_out(self, now_us: int) -> None:
        if self.job.does == "up" and (not self._left or self._left[0] != 0):
            self._end("not all items requested" if self._left else "no last acknowledgement", now_us)
        elif self._tries > self.RETRIES:
            self._end("timeout", now_us)
        else:
            self._tries += 1
            self._again(now_us)

    def _take(self, message: Message, now_us: int) -> None:
        kind = message.get_msgId()
        if getattr(message, "mission_type", None) != self.job.kind:
            return
        if kind == COUNT and self._expects == COUNT:
            self._tries = 0
            self._left = list(range(message.count))
            self._expects = ITEM
            self._read_on(now_us)
        elif kind == ITEM_INT and self._expects == ITEM:
            if message.seq in self._left:
                self._left.remove(message.seq)
                self._keep(message)
                self._tries = 0
                self._read_on(now_us)
            else:
                self._expect(ITEM, now_us)
        elif kind in {REQUEST, REQUEST_INT} and self._expects == REQUEST:
            if message.seq >= len(self.job.items):
                self._end("item out of range requested", now_us)
                return
            if message.seq in self._left:
                self._left.remove(message.seq)
            self._say_item(message.seq)
            self._expect(REQUEST, now_us)
        elif kind == ACK:
            complete = message.type == ACCEPTED and (
                self._expects == ACK or (self._expects == REQUEST and not self._left)
            )
            self._end("success" if complete else f"acknowledged {message.type}", now_us)

    def _read_on(self, now_us: int) -> None:
        if self._left:
            self._again(now_us)
        else:
            self._acknowledge()
            self._end("success", now_us)


class MavProxy(Client):
    """MAVProxy: sends MISSION_COUNT and MISSION_REQUEST_LIST once, requests five items at once, has no end.

    Its user sees whether all items were sent or received; the model gives up after a time.
    """

    REQUESTS, RETRY_US, LOOK_US, LOAD_US, PATIENCE_US = 5, 2_000_000, 2_000_000, 10_000_000, 60_000_000
    PAUSE_US = 10_000_000
    IN_INTEGERS = True

    def _start(self, now_us: int) -> None:
        self._give_up_us = now_us + self.PATIENCE_US
        self._sent_us = now_us
        self._expected: int | None = None
        self._asked_us: dict[int, int] = {}
        self._early: dict[int, Message] = {}
        self.due_us = now_us + self.LOOK_US
        if self.job.does == "up":
            self._say_count()
        elif self.job.does == "down":
            self._ask_list()
        else:
            self._say_clear()
            self._end("success", now_us)

    def _time_out(self, now_us: int) -> None:
        self.due_us = now_us + self.LOOK_US
        if now_us >= self._give_up_us or (self.job.does == "up" and now_us > self._sent_us + self.LOAD_US):
            self._end("given up", now_us)
        elif self.job.does == "down" and self._expected is not None:
            self._ask_missing(now_us)

    def _ask_missing(self, now_us: int) -> None:
        begin = len(self.job.got)
        for seq in range(begin, min(begin + self.REQUESTS, self._expected)):
            if now_us - self._asked_us.get(seq, -self.RETRY_US) >= self.RETRY_US:
                self._asked_us[seq] = now_us
                self._ask_item(seq)

    def _take(self, message: Message, now_us: int) -> None:
        kind, job = message.get_msgId(), self.job
        if getattr(message, "mission_type", None) != job.kind:
            return
        if job.does == "up" and kind in {REQUEST, REQUEST_INT} and message.seq < len(job.items):
            if (message.target_system, message.target_component) != (255, 190):
                return
            self._say_item(message.seq, in_integers=self.IN_INTEGERS)
            self._sent_us = now_us
            if message.seq == len(job.items) - 1:
                self._end("success", now_us)
        elif job.does == "down" and kind == COUNT:
            job.got.clear()
            self._expected = message.count
            self._ask_missing(now_us)
            self._end_if_complete(now_us)
        elif job.does == "down" and kind in {ITEM, ITEM_INT} and self._expected is not None:
            self._early[message.seq] = message
            while len(job.got) in self._early:
                self._keep(self._early.pop(len(job.got)))
            self._ask_missing(now_us)
            self._end_if_complete(now_us)

    def _end_if_complete(self, now_us: int) -> None:
        if len(self.job.got) == self._expected:
            self._end("success", now_us)


class OldStation(MavProxy):
    """A station of MAVLink 1's time: it supports MISSION_REQUEST and MISSION_ITEM only."""

    IN_INTEGERS = False

    def _take(self, message: Message, now_us: int) -> None:
        if message.get_msgId() not in {REQUEST_INT, ITEM_INT}:
            super()._take(message, now_us)

    def _ask_item(self, seq: int) -> None:
        self._out.append(common.MAVLink_mission_request_message(*VEHICLE, seq, int(self.job.kind)))

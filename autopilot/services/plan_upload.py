"""The writing of one plan: what has come, what is asked for, how long to wait, and how it ended."""

from collections.abc import Sequence
from typing import NamedTuple

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import MissionAck
from autopilot.navigation.plan_store import Plan, PlanType, WireItem
from autopilot.services.service import Addressed, Partner, reply

RETRY_US, SLOWEST_RETRY_US = 250_000, 450_000
"""After the first an item is asked for again (PX4), or up to the second where answers take that long: each
request makes MAVSDK send, and the sixth for the same item makes it give up."""
TIMEOUT_US = 5_000_000
"""After that without a word from the station a plan is no longer waited for."""
REPEAT_US = (600_000, 1_000_000)
"""After these the last acknowledgement is said again. A station that goes on at once is heard before, also
if its first word is lost (MAVSDK repeats it after 0.5 s): it would take the repetition for an answer to the
new word. A station that waits does so for 1.5 s (QGroundControl) or 2.5 s (MAVSDK)."""
STALE_US = 1_000_000
"""How long a late copy of a message may be expected."""
MOST_BACK = 8
"""By so many items at most a late copy of a request leads a station back."""
COPY_US = 300_000
"""MISSION_CLEAR_ALL again within that may be a late copy; MAVSDK repeats it after 0.5 s."""
PATIENT_RETRIES = 2
"""After so many in vain it is asked from further back, or in the other kind of message."""
ITEM_MESSAGES = frozenset({common.MAVLINK_MSG_ID_MISSION_ITEM, common.MAVLINK_MSG_ID_MISSION_ITEM_INT})


class UploadStation(NamedTuple):
    """Who speaks; several may be behind one address, and several addresses may have the same numbers."""

    partner: Partner
    system: int
    component: int

    def acknowledge(self, kind: int, result: int, opaque_id: int = 0) -> list[Addressed]:
        """MISSION_ACK to it, with a MAV_MISSION_RESULT."""
        return reply(self.partner, MissionAck(self.system, self.component, result, kind, opaque_id))


class Upload(Struct, kw_only=True):
    """A plan that is being written."""

    station: UploadStation
    kind: PlanType
    first: int
    last: int
    """Numbers of the items that are written"""
    before: Plan | None
    """Of which the other items stay; None where all are written"""
    items: list[WireItem]
    """From ``first`` on"""
    start: int
    """The item that the station has marked as current"""
    in_integers: bool = True
    asked: int
    """The missing item; or one further back, that the station may find its way"""
    asked_us: int
    """When it was asked for after the one before had come"""
    retry_us: int
    retries: int = 0
    """Since then"""
    heard_us: int
    """When the station last said something of it"""
    refused: UploadStation | None = None
    """Who else has been refused since then"""
    stray: int
    """Number of the last item that came though another was asked for"""
    stray_us: int = 0
    round_us: int = 0
    """How long answers take, and how much that varies: smoothed as TCP does (RFC 6298)"""
    variation_us: int = 0

    @property
    def missing(self) -> int:
        """Number of the first item that has not come."""
        return self.first + len(self.items)

    @property
    def patience_us(self) -> int:
        """How long to wait for an answer before asking again."""
        return max(RETRY_US, min(self.round_us + 4 * self.variation_us, SLOWEST_RETRY_US))

    def ask(self, seq: int) -> list[Addressed]:
        """Request to the station for an item."""
        request = common.MAVLink_mission_request_int_message
        if not self.in_integers:
            request = common.MAVLink_mission_request_message
        self.asked = seq
        station = self.station
        return reply(station.partner, request(station.system, station.component, seq, int(self.kind)))

    def learn_round(self, sample_us: int) -> None:
        """Take how long an answer took that was asked for once."""
        if not self.round_us:
            self.round_us, self.variation_us = sample_us, sample_us // 2
        self.variation_us += (abs(sample_us - self.round_us) - self.variation_us) // 4
        self.round_us += (sample_us - self.round_us) // 8


class UploadFinished(Struct, kw_only=True):
    """A plan whose writing has ended; the station may not know."""

    station: UploadStation
    kind: PlanType
    first: int
    last: int
    ended_us: int
    answer: Sequence[Addressed]
    """None where the station itself has ended it"""
    repeats_us: list[int]
    """When the answer is said again"""

    def is_meant_by(self, message: Message) -> bool:
        """Whether a message is an item of it, late or once more."""
        return (
            message.get_msgId() in ITEM_MESSAGES
            and message.mission_type == self.kind
            and bool(message.seq <= self.last)
        )

"""State of the upload of one plan: items received, item requested, retry times, and the result."""

from collections.abc import Sequence
from typing import NamedTuple

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import MissionAck
from autopilot.navigation.plan_store import Plan, PlanType, WireItem
from autopilot.services.service import Addressed, Partner, reply

RETRY_US, SLOWEST_RETRY_US = 250_000, 450_000
"""Time until an item is requested again: the first value (PX4), up to the second for long round trips. Each
request makes MAVSDK send the item, and the sixth for the same item makes it abort."""
TIMEOUT_US = 5_000_000
"""Silence of the station after which an upload is abandoned."""
REPEAT_US = (600_000, 1_000_000)
"""Delays after which the last acknowledgement is repeated. They exceed 0.5 s, after which MAVSDK repeats a
lost message: a station that goes on would take the repetition for the answer to its next message. A waiting
station waits for 1.5 s (QGroundControl) or 2.5 s (MAVSDK)."""
STALE_US = 1_000_000
"""How long after a message a late copy of it may arrive."""
MOST_BACK = 8
"""Largest number of items by which a late copy of a request may set a station back."""
COPY_US = 300_000
"""MISSION_CLEAR_ALL repeated within this time may be a late copy; MAVSDK repeats it after 0.5 s."""
PATIENT_RETRIES = 2
"""Unanswered requests after which an earlier item, or the other kind of message, is requested."""
ITEM_MESSAGES = frozenset({common.MAVLINK_MSG_ID_MISSION_ITEM, common.MAVLINK_MSG_ID_MISSION_ITEM_INT})


class UploadStation(NamedTuple):
    """Source of mission messages; several may share an address, and several addresses the same numbers."""

    partner: Partner
    system: int
    component: int

    def acknowledge(self, kind: int, result: int, opaque_id: int = 0) -> list[Addressed]:
        """MISSION_ACK to this station with a MAV_MISSION_RESULT."""
        return reply(self.partner, MissionAck(self.system, self.component, result, kind, opaque_id))


class Upload(Struct, kw_only=True):
    """A plan that is being written, or the last one that was."""

    station: UploadStation
    kind: PlanType
    span: range
    """Numbers of the items that are written"""
    before: Plan | None
    """Plan that provides the other items; None if all are written"""
    items: list[WireItem] = []
    """Items received so far, from the first of ``span`` on"""
    start: int
    """Number of the item that the station marked as current"""
    in_integers: bool = True
    asked: int
    """The missing item, or an earlier one to which the station has returned"""
    asked_us: int
    """Time of the first request for it, after the previous item arrived"""
    retry_us: int
    retries: int = 0
    """Requests for it since then"""
    heard_us: int
    """Time of the station's last message of this upload"""
    refused: UploadStation | None = None
    """Another station that was refused since then"""
    stray: int
    """Number of the last item that arrived without having been requested"""
    stray_us: int = 0
    round_us: int = 0
    """Round-trip time and its variation, smoothed as in TCP (RFC 6298)"""
    variation_us: int = 0
    ended_us: int = 0
    answer: Sequence[Addressed] = ()
    """The acknowledgement, which may be lost; empty if the station ended the upload"""
    repeats_us: list[int] = []
    """Times at which the acknowledgement is repeated"""

    @property
    def missing(self) -> int:
        """Number of the first item that has not arrived."""
        return self.span.start + len(self.items)

    @property
    def patience_us(self) -> int:
        """Time to wait for an answer before requesting again."""
        return max(RETRY_US, min(self.round_us + 4 * self.variation_us, SLOWEST_RETRY_US))

    def request(self, seq: int) -> list[Addressed]:
        """Return the request for an item."""
        make = common.MAVLink_mission_request_int_message
        if not self.in_integers:
            make = common.MAVLink_mission_request_message
        self.asked = seq
        station = self.station
        return reply(station.partner, make(station.system, station.component, seq, int(self.kind)))

    def measure_round(self, sample_us: int) -> None:
        """Update the round-trip time by that of an item that was requested once."""
        if not self.round_us:
            self.round_us, self.variation_us = sample_us, sample_us // 2
        self.variation_us += (abs(sample_us - self.round_us) - self.variation_us) // 4
        self.round_us += (sample_us - self.round_us) // 8

    def is_late_item(self, message: Message) -> bool:
        """Whether a message is a late or repeated item of this upload."""
        return (
            message.get_msgId() in ITEM_MESSAGES
            and message.mission_type == self.kind
            and bool(message.seq < self.span.stop)
        )

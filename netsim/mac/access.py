"""When a station may send: interframe spaces, contention windows and the backoff of one access category.

Source: IEEE 802.11-2016, 10.3.4 (DCF) and 10.22.2 (EDCA); 5 GHz OFDM timing of table 17-21. A backoff slot
counts once it has passed idle, as in DCF; a station that has nothing to send still counts its last backoff
down.
"""

from collections import deque

from msgspec import Struct

from netsim.frames import ACK_BYTES
from netsim.kernel import NEVER_NS, Event, EventQueue
from netsim.mac.jobs import Job
from netsim.phy.modes import phy_mode
from netsim.streams import Uniforms

SLOT_NS = 9_000
SIFS_NS = 16_000
EIFS_EXTRA_NS = SIFS_NS + phy_mode("ofdm6", 20).duration_ns(ACK_BYTES)
"""EIFS less DIFS: room for an ACK at the lowest rate that this station may not hear."""
SENSE_GUARD_NS = 2
"""What begins this close to a slot's boundary is not sensed before it: delays are rounded to nanoseconds."""


class AccessParameters(Struct, frozen=True, kw_only=True):
    """How eagerly a queue contends."""

    aifsn: int
    cw_min: int
    cw_max: int

    @property
    def aifs_ns(self) -> int:
        """Arbitration interframe space, SIFS + AIFSN slots."""
        return SIFS_NS + self.aifsn * SLOT_NS


DCF = AccessParameters(aifsn=2, cw_min=15, cw_max=1023)
EDCA = {
    "vo": AccessParameters(aifsn=2, cw_min=3, cw_max=7),
    "vi": AccessParameters(aifsn=2, cw_min=7, cw_max=15),
    "be": AccessParameters(aifsn=3, cw_min=15, cw_max=1023),
    "bk": AccessParameters(aifsn=7, cw_min=15, cw_max=1023),
}
"""By access category, in order of falling priority."""


class Contender:
    """One queue of a station and its backoff. Who calls it: its station, which alone knows the medium.

    While the medium is idle, ``base_ns`` is where slot 0 begins, AIFS after the medium fell idle; `freeze`
    turns the slots that have passed since then into a smaller backoff.
    """

    __slots__ = (
        "_uniforms",
        "access",
        "access_ns",
        "aifs_ns",
        "backoff_slots",
        "base_ns",
        "cw",
        "fresh",
        "jobs",
        "parameters",
    )

    def __init__(self, parameters: AccessParameters, uniforms: Uniforms) -> None:
        self.parameters = parameters
        self.aifs_ns = parameters.aifs_ns
        self.jobs: deque[Job] = deque()
        self.cw = parameters.cw_min
        self.backoff_slots = 0
        self.base_ns = NEVER_NS
        self.access: Event | None = None
        """The planned access; None when frozen or with nothing to send."""
        self.access_ns = NEVER_NS
        self.fresh = False
        """The frame found the medium idle and drew no backoff."""
        self._uniforms = uniforms

    def draw_backoff(self) -> None:
        """Draw a new backoff, uniform in 0..CW slots."""
        self.backoff_slots = int(self._uniforms.draw() * (self.cw + 1))
        self.fresh = False

    def succeeded(self) -> None:
        """Return to the smallest window and back off: the exchange went well, or its frame was given up."""
        self.cw = self.parameters.cw_min
        self.draw_backoff()

    def collided(self) -> None:
        """Back off in twice the window: the exchange failed."""
        self.cw = min(2 * self.cw + 1, self.parameters.cw_max)
        self.draw_backoff()

    def freeze(self, from_ns: int) -> None:
        """Stop counting, as the medium is busy from then on; an access planned for before goes ahead."""
        if self.access is not None:
            if self.access_ns <= from_ns + SENSE_GUARD_NS:
                return
            EventQueue.cancel(self.access)
            self.access = None
            if self.fresh:
                self.draw_backoff()
                self.base_ns = NEVER_NS
                return
        passed_ns = from_ns + SENSE_GUARD_NS - self.base_ns
        if passed_ns > 0:
            self.backoff_slots = max(0, self.backoff_slots - passed_ns // SLOT_NS)
        self.base_ns = NEVER_NS

"""When one queue may send: interframe spaces, contention windows and the backoff of one access category.

Source: IEEE 802.11-2016, 10.3.4 (DCF) and 10.22.2 (EDCA); 5 GHz OFDM timing of table 17-21. DCF counts a
slot once it has passed idle; EDCA counts at the boundaries of slots, so also the one whose beginning was idle
though somebody began to send in it (10.22.2.4). A station that has nothing to send still counts its last
backoff down.
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
CCA_NS = 4_000
"""aCCATime, for which energy goes unnoticed: who begins to send within it does so in spite of it."""


class AccessParameters(Struct, frozen=True, kw_only=True):
    """How eagerly a queue contends."""

    aifsn: int
    cw_min: int
    cw_max: int
    txop_ns: int = 0
    """TXOP limit, for which a queue may go on after a success; 0 is one exchange."""
    edca: bool = True
    """Backoff counts at the boundaries of slots; DCF's counts slots that have passed."""

    @property
    def aifs_ns(self) -> int:
        """Arbitration interframe space, SIFS + AIFSN slots."""
        return SIFS_NS + self.aifsn * SLOT_NS


DCF = AccessParameters(aifsn=2, cw_min=15, cw_max=1023, edca=False)
EDCA = {
    "vo": AccessParameters(aifsn=2, cw_min=3, cw_max=7, txop_ns=1_504_000),
    "vi": AccessParameters(aifsn=2, cw_min=7, cw_max=15, txop_ns=3_008_000),
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
        "_ahead_slots",
        "_uniforms",
        "access",
        "access_ns",
        "aifs_ns",
        "backoff_slots",
        "base_ns",
        "cw",
        "deadline",
        "deadline_ns",
        "fresh",
        "jobs",
        "parameters",
        "priority",
        "txop_ns",
    )

    def __init__(self, parameters: AccessParameters, priority: int, uniforms: Uniforms) -> None:
        self.parameters = parameters
        self.priority = priority
        """0 is the first."""
        self.aifs_ns = parameters.aifs_ns
        self.txop_ns = parameters.txop_ns
        self.jobs: deque[Job] = deque()
        self.cw = parameters.cw_min
        self.backoff_slots = 0
        self.base_ns = NEVER_NS
        self.access: Event | None = None
        """The planned access; None when frozen or with nothing to send."""
        self.access_ns = NEVER_NS
        self.fresh = False
        """The frame found the medium idle and drew no backoff."""
        self.deadline: Event | None = None
        self.deadline_ns = NEVER_NS
        """When frames whose lifetime is over are next looked for; never, if none is queued."""
        self._ahead_slots = 1 if parameters.edca else 0
        self._uniforms = uniforms

    def draw_backoff(self) -> None:
        """Draw a new backoff, uniform in 0..CW slots."""
        self.backoff_slots = int(self._uniforms.draw() * (self.cw + 1))
        self.fresh = False

    def succeeded(self) -> None:
        """Return to the smallest window and back off.

        So after a success, and after a frame was given up at its retry limit (10.3.3).
        """
        self.cw = self.parameters.cw_min
        self.draw_backoff()

    def collided(self) -> None:
        """Back off in twice the window: the exchange failed."""
        self.cw = min(2 * self.cw + 1, self.parameters.cw_max)
        self.draw_backoff()

    def freeze(self, from_ns: int) -> None:
        """Stop counting, as the medium is sensed busy from then on; an access until then goes ahead."""
        if self.access is not None:
            if self.access_ns <= from_ns:
                return
            EventQueue.cancel(self.access)
            self.access = None
            if self.fresh:
                self.draw_backoff()
                self.base_ns = NEVER_NS
                return
        if self.backoff_slots and from_ns >= self.base_ns:
            passed_slots = (from_ns - self.base_ns) // SLOT_NS + self._ahead_slots
            self.backoff_slots = max(0, self.backoff_slots - passed_slots)
        self.base_ns = NEVER_NS

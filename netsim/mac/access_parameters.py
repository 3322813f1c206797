"""Interframe spaces and contention windows of the access categories.

Source: IEEE 802.11-2016, 10.3.4 (DCF) and 10.22.2 (EDCA). Their values are the same for OFDM and ERP-OFDM;
slot and SIFS are in `netsim.phy.timing`.
"""

from msgspec import Struct

from netsim.phy.timing import PhyTiming

CCA_NS = 4_000
"""aCCATime: energy is detected after this time; until then a planned transmission still begins.

Table 18-5 permits up to 15 us with the long slot; the receiver is the same with both slots.
"""


class AccessParameters(Struct, frozen=True, kw_only=True):
    """Contention parameters of a queue."""

    aifsn: int
    cw_min: int
    cw_max: int
    txop_ns: int = 0
    """TXOP limit, within which a queue may continue after a success; 0: one exchange."""
    edca: bool = True
    """EDCA backoff is decremented at slot boundaries, DCF backoff (False) after idle slots."""

    def aifs_ns(self, timing: PhyTiming) -> int:
        """Return the arbitration interframe space: SIFS + AIFSN slots."""
        return timing.sifs_ns + self.aifsn * timing.slot_ns


DCF = AccessParameters(aifsn=2, cw_min=15, cw_max=1023, edca=False)
EDCA = {
    "vo": AccessParameters(aifsn=2, cw_min=3, cw_max=7, txop_ns=1_504_000),
    "vi": AccessParameters(aifsn=2, cw_min=7, cw_max=15, txop_ns=3_008_000),
    "be": AccessParameters(aifsn=3, cw_min=15, cw_max=1023),
    "bk": AccessParameters(aifsn=7, cw_min=15, cw_max=1023),
}
"""By access category, in order of falling priority."""

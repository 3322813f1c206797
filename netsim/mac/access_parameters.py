"""Interframe spaces and contention windows of the access categories.

Source: IEEE 802.11-2016, 10.3.4 (DCF) and 10.22.2 (EDCA). Default EDCA parameters of OFDM PHYs: tables 9-137
of 802.11-2016 and 9-155 of 802.11-2020, which differ in TXOP limits. They are the same for OFDM and ERP-OFDM;
slot and SIFS are in `netsim.phy.timing`.
"""

from msgspec import Struct
from msgspec.structs import replace

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
    """EDCA counts backoff and begins at slot boundaries; DCF (False) counts idle slots and begins at once."""

    def aifs_ns(self, timing: PhyTiming) -> int:
        """Return the arbitration interframe space: SIFS + AIFSN slots."""
        return timing.sifs_ns + self.aifsn * timing.slot_ns


DCF = AccessParameters(aifsn=2, cw_min=15, cw_max=1023, edca=False)
EDCA: dict[str, AccessParameters] = {
    "vo": AccessParameters(aifsn=2, cw_min=3, cw_max=7, txop_ns=1_504_000),
    "vi": AccessParameters(aifsn=2, cw_min=7, cw_max=15, txop_ns=3_008_000),
    "be": AccessParameters(aifsn=3, cw_min=15, cw_max=1023),
    "bk": AccessParameters(aifsn=7, cw_min=15, cw_max=1023),
}
"""By access category, in order of falling priority: the edition of 2016."""
_LIMITS_2020_NS = {"vo": 2_080_000, "vi": 4_096_000, "be": 2_528_000, "bk": 2_528_000}
EDCA_2020 = {each: replace(EDCA[each], txop_ns=limit_ns) for each, limit_ns in _LIMITS_2020_NS.items()}
"""The edition of 2020."""


def edca_parameters(edition: int) -> dict[str, AccessParameters]:
    """Return the default EDCA parameters of the edition of 2016 or 2020, by access category."""
    return EDCA_2020 if edition == 2020 else EDCA

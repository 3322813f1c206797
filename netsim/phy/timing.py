"""Times of the PHY that the MAC's intervals consist of, by band and coverage class.

Sources: IEEE 802.11-2016, table 17-21 (OFDM), table 18-5 (ERP, here ERP-OFDM alone), 10.3.7 (intervals),
10.3.2.9 (time-outs of responses), 10.3.8 (signal extension), 9.4.2.9 (coverage class). Between 2400 and 2500
MHz the PHY is ERP-OFDM, at any other frequency OFDM with the timing of 5 GHz.
"""

from functools import cache

from msgspec import Struct

from netsim.model.config import Mode, RadioConfig
from netsim.phy.frames import ACK_BYTES
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, phy_mode
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S

BAND_2_4_GHZ_MHZ = (2_400.0, 2_500.0)
CENTRES_2_4_GHZ_MHZ: dict[int, tuple[float, ...]] = {
    20: (*(2_412.0 + 5.0 * k for k in range(13)), 2_484.0),
    40: tuple(2_422.0 + 5.0 * k for k in range(9)),
}
"""Centre frequencies of channels by width in MHz: channels 1 to 14, and pairs of channels 1 to 13."""
CLASS_NS = 3_000
"""aAirPropagationTime of coverage class 1; class c has c times as much (9.4.2.9)."""
RX_START_DELAY_NS = NON_HT_PREAMBLE_NS
"""aRxPHYStartDelay of OFDM and ERP-OFDM: from the arrival of a preamble to PHY-RXSTART.indication."""


class PhyTiming(Struct, frozen=True, kw_only=True):
    """Slot, SIFS and signal extension, in nanoseconds, and what follows from them."""

    slot_ns: int
    """aSlotTime, with aAirPropagationTime of the coverage class."""
    sifs_ns: int
    """From the end of a frame, with its signal extension, to the begin of the next one."""
    signal_extension_ns: int = 0
    """Time at the end of each frame in which nothing is sent; part of the frame's duration."""

    @property
    def response_timeout_ns(self) -> int:
        """Time from the end of a frame to the latest PHY-RXSTART of its CTS or ACK."""
        return self.sifs_ns + self.slot_ns + RX_START_DELAY_NS

    @property
    def eifs_extra_ns(self) -> int:
        """EIFS minus DIFS: time for an ACK at the lowest rate, which this station may not receive."""
        return self.sifs_ns + phy_mode("ofdm6", 20, self.signal_extension_ns).duration_ns(ACK_BYTES)

    @property
    def farthest_m(self) -> float:
        """Range limit of the emulator, metres: a propagation delay of SIFS.

        Beyond it a response could begin before the frame has ended at all stations.
        """
        return 1e-9 * self.sifs_ns * SPEED_OF_LIGHT_M_S


def is_2_4_ghz(frequency_mhz: float) -> bool:
    """Whether the PHY at a centre frequency is ERP-OFDM."""
    return BAND_2_4_GHZ_MHZ[0] <= frequency_mhz <= BAND_2_4_GHZ_MHZ[1]


def timing_of(config: RadioConfig) -> PhyTiming:
    """Return the timing of a channel from its frequency, coverage class and slot."""
    return _timing(
        erp=is_2_4_ghz(config.frequency_mhz),
        short_slot=config.short_slot,
        coverage_class=config.coverage_class,
    )


@cache
def _timing(*, erp: bool, short_slot: bool, coverage_class: int) -> PhyTiming:
    air_ns = CLASS_NS * coverage_class
    if not erp:
        return PhyTiming(slot_ns=9_000 + air_ns, sifs_ns=16_000)
    slot_ns = 9_000 if short_slot else 20_000
    return PhyTiming(slot_ns=slot_ns + air_ns, sifs_ns=10_000, signal_extension_ns=6_000)


def channel_mode(config: RadioConfig, name: Mode) -> PhyMode:
    """Return a mode on the channel of these settings. Raises ValueError as `netsim.phy.modes.phy_mode`."""
    return phy_mode(name, config.bandwidth_mhz, timing_of(config).signal_extension_ns)

"""PHY modes and air times of frames: non-HT OFDM and VHT with one spatial stream, long guard interval.

Sources: IEEE 802.11-2016 clause 17 (OFDM), clause 21 (VHT), 10.7.6.5 (rates of control responses).
"""

from functools import cache
from typing import get_args

from msgspec import Struct

from netsim.model.config import BandwidthMhz, Mode

MODE_NAMES: list[Mode] = list(get_args(Mode))
"""Mode names in the order of the rows of `netsim.model.tables`."""
SYMBOL_NS = 4_000
NON_HT_PREAMBLE_NS = 20_000
"""L-STF 8 us, L-LTF 8 us, L-SIG 4 us."""
VHT_PREAMBLE_NS = 40_000
"""The non-HT preamble, VHT-SIG-A 8 us, VHT-STF, one VHT-LTF and VHT-SIG-B of 4 us each."""
SERVICE_AND_TAIL_BITS = 22
VHT_DELIMITER_BYTES = 4
"""A single VHT frame is also an A-MPDU, with a delimiter before it."""

_NON_HT_SUBCARRIERS = 48
_VHT_SUBCARRIERS: dict[int, int] = {20: 52, 40: 108, 80: 234}
# mode -> (bits per subcarrier, numerator and denominator of the code rate)
_MODULATION: dict[str, tuple[int, int, int]] = {
    "ofdm6": (1, 1, 2), "ofdm9": (1, 3, 4), "ofdm12": (2, 1, 2), "ofdm18": (2, 3, 4),
    "ofdm24": (4, 1, 2), "ofdm36": (4, 3, 4), "ofdm48": (6, 2, 3), "ofdm54": (6, 3, 4),
    "vht_mcs0": (1, 1, 2), "vht_mcs1": (2, 1, 2), "vht_mcs2": (2, 3, 4), "vht_mcs3": (4, 1, 2),
    "vht_mcs4": (4, 3, 4), "vht_mcs5": (6, 2, 3), "vht_mcs6": (6, 3, 4), "vht_mcs7": (6, 5, 6),
    "vht_mcs8": (8, 3, 4), "vht_mcs9": (8, 5, 6),
}  # fmt: skip


class PhyMode(Struct, frozen=True, kw_only=True, eq=False):
    """One modulation and coding at one channel width; use `phy_mode`, which returns one object each."""

    name: Mode
    bandwidth_mhz: BandwidthMhz
    vht: bool
    bits_per_subcarrier: int
    code_rate: tuple[int, int]
    bits_per_symbol: int
    """Data bits in one OFDM symbol, N_DBPS."""
    preamble_ns: int
    signal_extension_ns: int = 0
    """Time at the end of a frame in which nothing is sent: 6 us at 2.4 GHz (10.3.8)."""

    def duration_ns(self, frame_bytes: int) -> int:
        """Return the air time of a frame; ``frame_bytes`` includes MAC header and FCS.

        Non-HT: 20 us + 4 us ceil((22 + 8 L) / N_DBPS), equation 17-29, and the signal extension (18.5.3).
        VHT: 40 us + 4 us ceil((22 + 8 (L + 4)) / N_DBPS), equation 21-107 with one encoder.
        """
        length = frame_bytes + VHT_DELIMITER_BYTES if self.vht else frame_bytes
        symbols = -(-(SERVICE_AND_TAIL_BITS + 8 * length) // self.bits_per_symbol)
        return self.preamble_ns + SYMBOL_NS * symbols + self.signal_extension_ns


@cache
def phy_mode(name: Mode, bandwidth_mhz: BandwidthMhz, signal_extension_ns: int = 0) -> PhyMode:
    """Return the mode at a channel width; `netsim.phy.timing.channel_mode` takes both from the settings.

    A non-HT frame on a wider channel is a non-HT duplicate (17.3.9): the same bits in every 20 MHz, with the
    duration of 20 MHz and the power spread over the channel. Raises ValueError for VHT MCS 9 at 20 MHz, which
    does not exist.
    """
    bits, numerator, denominator = _MODULATION[name]
    vht = name.startswith("vht")
    if name == "vht_mcs9" and bandwidth_mhz == 20:
        raise ValueError("VHT MCS 9 does not exist on a 20 MHz channel")
    subcarriers = _VHT_SUBCARRIERS[bandwidth_mhz] if vht else _NON_HT_SUBCARRIERS
    return PhyMode(
        name=name,
        bandwidth_mhz=bandwidth_mhz,
        vht=vht,
        bits_per_subcarrier=bits,
        code_rate=(numerator, denominator),
        bits_per_symbol=subcarriers * bits * numerator // denominator,
        preamble_ns=VHT_PREAMBLE_NS if vht else NON_HT_PREAMBLE_NS,
        signal_extension_ns=signal_extension_ns,
    )


@cache
def response_mode(of: PhyMode) -> PhyMode:
    """Return the mode of the CTS or ACK that responds to a frame.

    It is the highest mandatory rate (6, 12, 24 Mbit/s) not above the frame's. A VHT frame counts with the
    non-HT rate of its modulation (10.7.6.5.2, 10.7.10).
    """
    bits = of.bits_per_subcarrier
    name: Mode = "ofdm6" if bits == 1 else "ofdm12" if bits == 2 else "ofdm24"
    return phy_mode(name, of.bandwidth_mhz, of.signal_extension_ns)

"""Encode radiotap headers: a captured frame's time, mode, channel and power.

A frame as sent has the transmitter's power and no signal strength. A frame as received has signal strength
and noise, in whole dBm, and a flag if it was received with errors. The channel frequency is the centre
frequency (a driver reports that of the primary 20 MHz channel, which the emulator does not model). A non-HT
frame on a wider channel, duplicated in every 20 MHz, has only the rate field. A VHT frame is an A-MPDU of
one MPDU, whose delimiter has the EOF bit (a VHT single MPDU: IEEE 802.11-2016, 3.2 and 9.7): it is the last
subframe, and each has a reference number of its own. The packet has no delimiter and no padding.

There are two times, both simulated. TSFT is the time of the first bit of the MPDU, in whole microseconds. The
timestamp field is the beginning of the preamble, in nanoseconds. Wireshark reads TSFT as the end of a frame
unless its preference wlan_radio.tsf_at_end is off. Source: radiotap.org, "defined fields"; a field is aligned
to its own size, counted from the header's first byte.
"""

from struct import Struct as Layout

from netsim.phy.modes import PhyMode
from netsim.phy.timing import is_2_4_ghz

_TSFT, _FLAGS, _RATE, _CHANNEL, _SIGNAL, _NOISE, _TX_POWER, _AMPDU, _VHT, _TIMESTAMP = (
    1 << bit for bit in (0, 1, 2, 3, 5, 6, 10, 20, 21, 22)
)
_FLAGS_FCS_AT_END, _FLAGS_BAD_FCS = 0x10, 0x40
_CHANNEL_OFDM, _CHANNEL_2_GHZ, _CHANNEL_5_GHZ = 0x0040, 0x0080, 0x0100
_BAND_5_GHZ_FROM_MHZ = 4_900.0
_FREQUENCY_MAX_MHZ = 65_535
_POWER_MAX_DBM = 127
_VHT_KNOWN = 0x0001 | 0x0004 | 0x0020 | 0x0040
"""STBC, guard interval, beam-forming (none; long; none: flags 0) and bandwidth."""
_VHT_BANDWIDTH: dict[int, int] = {20: 0, 40: 1, 80: 4}
_VHT_STREAMS = 1
_AMPDU_FLAGS = 0x0004 | 0x0008 | 0x0040 | 0x0080
"""The last subframe is known; this is the last subframe; the EOF bit of its delimiter is set, and known."""
_REFERENCE_NUMBERS = 2**32
_NANOSECONDS, _START_OF_PREAMBLE = 2, 1 << 4
_ACCURACY_NS, _ACCURACY_KNOWN = 1, 0x02

_HEAD = Layout("<BBHI")
_PROPERTIES = Layout("<BBHHbb")
"""Flags; rate, or a gap before the channel; frequency and flags of the channel; the transmit power or the
signal; the noise or a gap."""
_VHT_FIELD = Layout("<HBB4sBBH4x")
"""With the gap before the timestamp."""
_AMPDU_FIELD = Layout("<IHBB")
"""Reference number, flags, delimiter CRC (not known), reserved."""
_TIME = Layout("<Q")
_TIMESTAMP_TAIL = Layout("<HBB").pack(_ACCURACY_NS, _NANOSECONDS | _START_OF_PREAMBLE, _ACCURACY_KNOWN)


class Radiotap:
    """Headers of the frames of one mode and power; only their times differ.

    ``power_dbm`` is the transmit power or, with ``is_received``, the received power, beside the ``noise_dbm``
    of the receiver if it has noise; ``bad_fcs`` marks frames received with errors.
    """

    def __init__(
        self,
        mode: PhyMode,
        *,
        frequency_mhz: float,
        power_dbm: float,
        is_received: bool = False,
        noise_dbm: float | None = None,
        bad_fcs: bool = False,
    ) -> None:
        present = _TSFT | _FLAGS | _CHANNEL | _TIMESTAMP | (_AMPDU | _VHT if mode.vht else _RATE)
        present |= _SIGNAL if is_received else _TX_POWER
        present |= 0 if noise_dbm is None else _NOISE
        self._preamble_ns = mode.preamble_ns
        channel_flags = _CHANNEL_OFDM
        if frequency_mhz >= _BAND_5_GHZ_FROM_MHZ:
            channel_flags |= _CHANNEL_5_GHZ
        elif is_2_4_ghz(frequency_mhz):
            channel_flags |= _CHANNEL_2_GHZ
        self._properties = _PROPERTIES.pack(
            _FLAGS_FCS_AT_END | _FLAGS_BAD_FCS if bad_fcs else _FLAGS_FCS_AT_END,
            0 if mode.vht else mode.bits_per_symbol // 2,  # rate / 500 kbit/s, as a symbol lasts 4 us
            min(round(frequency_mhz), _FREQUENCY_MAX_MHZ),
            channel_flags,
            _whole_dbm(power_dbm),
            0 if noise_dbm is None else _whole_dbm(noise_dbm),
        )
        self._vht = b""
        if mode.vht:
            mcs = int(mode.name.removeprefix("vht_mcs"))
            users = bytes((mcs << 4 | _VHT_STREAMS, 0, 0, 0))
            bandwidth = _VHT_BANDWIDTH[mode.bandwidth_mhz]
            self._vht = _VHT_FIELD.pack(_VHT_KNOWN, 0, bandwidth, users, 0, 0, 0)
        length = _HEAD.size + 2 * _TIME.size + len(self._properties) + len(_TIMESTAMP_TAIL)
        if mode.vht:
            length += _AMPDU_FIELD.size + _VHT_FIELD.size
        self._head = _HEAD.pack(0, 0, length, present)

    def header(self, start_ns: int, number: int) -> bytes:
        """Return the header of a frame whose preamble begins at the simulated time ``start_ns``.

        ``number`` differs from that of the packets next to it: Wireshark takes consecutive VHT frames with
        the same reference number for subframes of one A-MPDU, of whatever interface.
        """
        mpdu_us = (start_ns + self._preamble_ns) // 1_000
        fields = self._properties
        if self._vht:
            fields += _AMPDU_FIELD.pack(number % _REFERENCE_NUMBERS, _AMPDU_FLAGS, 0, 0) + self._vht
        return self._head + _TIME.pack(mpdu_us) + fields + _TIME.pack(start_ns) + _TIMESTAMP_TAIL


def _whole_dbm(power_dbm: float) -> int:
    return max(-_POWER_MAX_DBM, min(round(power_dbm), _POWER_MAX_DBM))

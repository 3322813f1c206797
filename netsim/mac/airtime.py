"""Air times of frames and frame exchanges.

The functions are compiled and work on the tables of `netsim.model.tables`.
"""

from foundation.kernels.inner import constant, inner
from netsim.model import tables as t
from netsim.model.records import MediumHeader
from netsim.phy.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES
from netsim.phy.modes import SERVICE_AND_TAIL_BITS, SYMBOL_NS, VHT_DELIMITER_BYTES

_ACK, _CTS, _RTS = constant(ACK_BYTES), constant(CTS_BYTES), constant(RTS_BYTES)


@inner
def duration_ns(air: MediumHeader, mode: int, frame_bytes: int) -> int:
    """Return the air time of a frame: see `netsim.phy.modes.PhyMode.duration_ns`."""
    phy = t.mode(air, mode)
    length = frame_bytes + VHT_DELIMITER_BYTES * phy.vht
    symbols = -(-(SERVICE_AND_TAIL_BITS + 8 * length) // phy.bits_per_symbol)
    return phy.preamble_ns + SYMBOL_NS * symbols + air.signal_extension_ns


@inner
def response_ns(air: MediumHeader, job: int) -> int:
    """Return the time from the end of a job's frame to the end of its ACK; 0 for a group frame."""
    if t.job(air, job).to == GROUP:
        return 0
    mode = t.mode(air, t.job(air, job).mode).response_mode
    return air.sifs_ns + duration_ns(air, mode, _ACK)


@inner
def data_ns(air: MediumHeader, job: int) -> int:
    """Return the time from the beginning of a job's frame to the end of its ACK."""
    mode, frame_bytes = t.job(air, job).mode, t.job(air, job).frame_bytes
    return duration_ns(air, mode, frame_bytes) + response_ns(air, job)


@inner
def cts_ns(air: MediumHeader) -> int:
    """Return the air time of a CTS."""
    mode = t.mode(air, air.control_mode).response_mode
    return duration_ns(air, mode, _CTS)


@inner
def exchange_ns(air: MediumHeader, job: int) -> int:
    """Return the duration of a job's exchange, RTS and CTS included."""
    if not t.job(air, job).rts:
        return data_ns(air, job)
    rts_ns = duration_ns(air, air.control_mode, _RTS)
    return rts_ns + air.sifs_ns + cts_ns(air) + air.sifs_ns + data_ns(air, job)

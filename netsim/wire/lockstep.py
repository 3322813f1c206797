"""Messages and flags that keep time master, emulator and vehicles in lockstep.

Interval requests use a separate socket (`netsim.transport.interval_stream`), whose two ends belong to one run
and so to one version. The vehicles' batches use Zenoh; two bits of the messages between simulator and vehicle
announce that a batch follows there.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from netsim.wire.messages import Station, TimeUs

BATCH_HANDED_OVER = 1 << 32
"""Bit of HIL_ACTUATOR_CONTROLS.flags, unused in the standard: the vehicle has sent a batch to its radio."""
BATCH_DELIVERED = 1 << 30
"""Bit of HIL_SENSOR.fields_updated, unused in the standard: the radio delivers a batch for this step."""

LEAD_US = 60_000_000
"""Most time by which a transmission may be ahead of the simulated channel."""
RangeOffset = Annotated[float, Meta(ge=-1e6, le=1e6)]
Rows = bytes
"""A matrix of little-endian float64, row after row, one row per station: `pack_rows`, `unpack_rows`."""


class Advance(Struct, frozen=True, kw_only=True, array_like=True):
    """Request of the time master: simulate the channel up to ``to_us``. The reply is `Advanced`."""

    to_us: TimeUs
    release_us: TimeUs
    """Time at which the hosts may process items received in this interval."""
    at_us: TimeUs
    """Beginning of the interval and time of the positions; velocities are constant in the interval."""
    pos_ned_m: Rows
    """(stations, 3)"""
    vel_ned_m_s: Rows
    """(stations, 3)"""
    q_ned_frd: Rows
    """(stations, 4), Hamilton wxyz: attitudes, which orient the antennas."""
    senders: tuple[Station, ...] = ()
    """Vehicles that have sent a batch of ``at_us``; the emulator waits for these batches."""
    silent: tuple[Station, ...] = ()
    """Stations that have ended: their radios are off, and the emulator does not wait for their batches."""
    extra_attenuation_db: Annotated[float, Meta(ge=0.0, le=1_000.0)]
    """Extra attenuation of every link from now on"""
    range_offsets_m: tuple[tuple[Station, RangeOffset], ...] = ()
    """Offsets added to measured ranges from now on, by initiator; without an entry there is none."""
    due_ns: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    """Wall time of the machine's monotonic clock at which ``to_us`` is due; 0: the run has no pace."""
    speed: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Simulated seconds per wall second; 0: the run has no pace."""


class Advanced(Struct, frozen=True, kw_only=True, array_like=True):
    """The channel has been simulated up to ``to_us``, and its deliveries are being sent.

    With ``missing`` stations the interval has not been simulated: the time master decides about them and
    repeats the request.
    """

    to_us: TimeUs
    quiet_until_us: TimeUs
    """Earliest time of the next event on the channel without further submissions."""
    busy_ns: Annotated[int, Meta(ge=0)] = 0
    """Time since the start for which the medium carried at least one transmission."""
    delivered: tuple[Station, ...] = ()
    """Vehicles that receive a batch for the interval's ``release_us`` and must be notified."""
    missing: tuple[Station, ...] = ()
    """Senders whose batches have not arrived within `netsim.transport.interval_stream.BATCH_LIMIT_S`."""


def pack_rows(matrix: NDArray[np.float64]) -> Rows:
    """Return the bytes of a matrix with one row per station."""
    return matrix.astype("<f8", copy=False).tobytes()


def unpack_rows(rows: Rows, *, stations: int, columns: int) -> NDArray[np.float64] | None:
    """Return the matrix (stations, columns), or None if the length of the bytes does not match."""
    if len(rows) != 8 * stations * columns:
        return None
    return np.frombuffer(rows, "<f8").astype(np.float64).reshape(stations, columns)

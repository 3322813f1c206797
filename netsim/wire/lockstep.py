"""What the time master tells the emulator and the vehicles so that they keep step.

The emulator hears of an interval by messages over a line of its own (`netsim.transport.interval_stream`),
whose two ends are of one run and so of one version. The vehicles' batches go another way than the step's
messages, and two bits of the simulator's link tell who waits for one that it comes.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from netsim.wire.messages import Station, TimeUs

BATCH_HANDED_OVER = 1 << 32
"""Bit of HIL_ACTUATOR_CONTROLS.flags, free in the standard: the vehicle gave its radio something to send."""
BATCH_DELIVERED = 1 << 30
"""Bit of HIL_SENSOR.fields_updated, free in the standard: the radio has brought something for this step."""

LEAD_US = 60_000_000
"""How far ahead of the air a transmission's time may lie."""
RangeOffset = Annotated[float, Meta(ge=-1e6, le=1e6)]
Rows = bytes
"""A matrix of little-endian float64, row after row, one row per station: `pack_rows`, `unpack_rows`."""
_FLOAT64_BYTES = 8


class Advance(Struct, frozen=True, kw_only=True, array_like=True):
    """From the time master: simulate the air up to ``to_us``. Answered by `Advanced`."""

    to_us: TimeUs
    release_us: TimeUs
    """When the hosts may see what arrives in this interval."""
    at_us: TimeUs
    """Beginning of the interval, for which the positions hold; the stations go on at these velocities."""
    pos_ned_m: Rows
    """(stations, 3)"""
    vel_ned_m_s: Rows
    """(stations, 3)"""
    q_ned_frd: Rows
    """(stations, 4), Hamilton wxyz: attitude, from which the antennas' directions follow."""
    senders: tuple[Station, ...] = ()
    """Vehicles that have handed over a batch of ``at_us``, without which the air does not go on."""
    silent: tuple[Station, ...] = ()
    """Stations that are gone: their radios send and answer nothing, and nobody waits for their batches."""
    extra_attenuation_db: Annotated[float, Meta(ge=0.0, le=1_000.0)] | None = None
    """From now on, this attenuation on every link instead of the scenario's."""
    range_offsets_m: tuple[tuple[Station, RangeOffset], ...] = ()
    """From now on, by how much stations' radios measure too far, each in the sessions that it began; none is
    in force that is not named."""


class Advanced(Struct, frozen=True, kw_only=True, array_like=True):
    """The air has been simulated up to ``to_us``, and its deliveries are under way.

    Or, with somebody ``missing``, it has not: the time master decides on them and asks again.
    """

    to_us: TimeUs
    quiet_until_us: TimeUs
    """Unless a station hands over something new, nothing happens on the air before this time."""
    busy_ns: Annotated[int, Meta(ge=0)] = 0
    """Time since the start for which the medium carried at least one transmission."""
    delivered: tuple[Station, ...] = ()
    """Vehicles that get a batch for the interval's ``release_us``, and have to be told."""
    missing: tuple[Station, ...] = ()
    """Senders whose batches have not come within `netsim.transport.interval_stream.BATCH_LIMIT_S`."""


def pack_rows(matrix: NDArray[np.float64]) -> Rows:
    """Bytes of a matrix with one row per station."""
    return matrix.astype("<f8", copy=False).tobytes()


def unpack_rows(rows: Rows, *, stations: int, columns: int) -> NDArray[np.float64] | None:
    """Matrix (stations, columns), or None if the bytes are not of that many numbers."""
    if len(rows) != _FLOAT64_BYTES * stations * columns:
        return None
    return np.frombuffer(rows, "<f8").astype(np.float64).reshape(stations, columns)

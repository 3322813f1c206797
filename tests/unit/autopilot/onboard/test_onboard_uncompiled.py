"""Compiled and interpreted kernels of the application give bitwise equal results."""

import numpy as np
import pytest
from beacons import Beacon, encode

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation import avoidance, formation_control
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation import (
    common_frame,
    distances,
    kernels,
    measurement_update,
    receivers,
    tracks,
    trust,
    uncertainty,
)
from autopilot.onboard.localisation.members import FILTER, MEMBER, new_filter
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio import neighbour_table

N = 4
RNG = np.random.default_rng(0)


def some(*shape, size=1.0):
    return size * RNG.standard_normal(shape)


def cov():
    root = some(5 * N, 5 * N, size=0.3)
    return root @ root.T


def filtered():
    return some(5 * N), cov()


def flags():
    return RNG.uniform(size=N) < 0.7


def listed(kind, count):
    """Return rows of a structured array with random numbers; times are of the last second."""
    rows = np.zeros(count, kind)
    for name in kind.names:
        column = rows[name]
        if column.dtype.kind == "f":
            column[...] = np.abs(some(*column.shape)) if name.endswith("_m2") else some(*column.shape)
        elif column.dtype.itemsize == 1:
            column[...] = RNG.integers(2, size=column.shape)
        elif name.endswith("_us"):
            column[...] = RNG.integers(9_000_000, 10_000_000, size=column.shape)
    return rows


def kept():
    """Return records of members, some of which were fresh within `KEEP_US`."""
    rows = listed(avoidance.KEPT, N)
    rows["station"], rows["limit_m"] = (0, 2, 3, 5), np.abs(rows["limit_m"])
    rows["seen_us"] -= RNG.choice((0, avoidance.KEEP_US), size=N)
    return rows


def rings():
    rows = listed(tracks.RING, N)
    rows["pushed"] = RNG.integers(2 * tracks.SAMPLES, size=N)
    rows["times_us"] = np.sort(rows["times_us"], axis=1)
    return rows


def filter_row():
    """Return the row of a filter with four pending distances."""
    row, given = listed(FILTER, 1), new_filter(1, LocalisationModel())
    for name in FILTER.names[FILTER.names.index("gps_bias_std_m") :]:
        row[name] = given[name]
    row["own"], row["decay_stride_us"], row["pending"] = 1, 600_000, 4
    return row


def pages(count=3):
    """Return pages with beacons of stations 2 and 3, some of which are new."""
    buffer = wire.BeaconBuffer(count)
    for _ in range(count):
        station = int(RNG.integers(2, 4))
        beacon = Beacon(
            station=station, seq=int(RNG.integers(20)), time_us=int(RNG.integers(9_500_000, 10_500_000)),
            phase=FlightPhase(RNG.integers(9)), odometry_ned_m=tuple(some(3)), vel_ned_m_s=tuple(some(3)),
            motion_start_ms=None if RNG.integers(2) else 9_000,
            fix=None if RNG.integers(4) == 0 else
                Fix(int(RNG.integers(9_000, 10_500)), tuple(some(3)), 2.0, None),
            gps_error=None if RNG.integers(2) else wire.GpsError(tuple(some(3)), 1.0),
            distances=tuple(
                wire.Distance(peer, int(RNG.integers(9_000, 10_500)), 9.0 + peer, 0.1)
                for peer in (0, 1, 5)),
        )  # fmt: skip
        buffer.put(station, encode(beacon))
    return buffer.rows


def numbers():
    """Return the rows of six stations."""
    return np.array((0, 1, 2, 3, -1, -1))


def fixed(rows):
    """Return members with a mean of fixes that is nearly complete."""
    rows["fixes"], rows["mean_fixes"] = 3, 4
    return rows


def waiting():
    items = listed(distances.PENDING, 20)
    items["initiator"], items["responder"] = RNG.integers(N, size=20), RNG.integers(N, size=20)
    return items


def listener():
    """Return the row of station 0, with a beacon period of 100 ms."""
    return np.array([(0, 100_000, 12.0, 2.25, 0, 0, 0, 0)], neighbour_table.LISTENER)


CASES = {
    common_frame.laid_onto: lambda: (some(5, 2, size=6.0), some(5, 2, size=0.3)),
    common_frame.towards_mean_gps: lambda: (10_000_000, listed(neighbour_table.STATION, 7), 1.0, -2.0),
    common_frame.run_round: lambda: (
        2, 10_000_000, np.array((0, 2, 3, 5)), listed(neighbour_table.STATION, 7), listed(MEMBER, N), rings(),
        some(5 * N), 0.2, -0.1),
    wire.is_credible: lambda: (pages()[0], True),
    neighbour_table.receive_beacon: lambda: (
        pages()[0], 10_000_000, listener(), listed(neighbour_table.STATION, 6), numbers()),
    neighbour_table.receive_beacons: lambda: (
        3, 10_000_000, pages(), listener(), listed(neighbour_table.STATION, 6), numbers()),
    neighbour_table.all_held: lambda: (listed(neighbour_table.STATION, 7), np.array((0, 2, 3)), 9_500_000),
    tracks.push: lambda: (
        listed(MEMBER, N), rings(), 2, int(RNG.integers(9_500_000, 10_500_000)), some(6), np.zeros(2)),
    tracks.odometry_at: lambda: (rings(), 2, int(RNG.integers(9_000_000, 10_100_000)), np.zeros(3)),
    tracks.odometry_between: lambda: (rings(), 2, 0, int(RNG.integers(9_000_000, 10_000_000)), np.zeros(3)),
    receivers.add_fix: lambda: (listed(MEMBER, N), 2, 10_100_000, some(3), some(3), bool(RNG.integers(2))),
    receivers.take_stated: lambda: (listed(MEMBER, N), 2, 3.0, 4.0, cov(), filter_row()),
    receivers.rate: lambda: (listed(MEMBER, N), 2, some(5 * N)),
    trust.note: lambda: (listed(MEMBER, N), 2, 1, bool(RNG.integers(2))),
    measurement_update.advance: lambda: (
        filter_row(), listed(MEMBER, N), *filtered(), int(RNG.integers(9_000_000, 11_000_000)),
        bool(RNG.integers(2))),
    measurement_update.read_beacons: lambda: (
        3, 10_000_000, pages(), listener(), listed(neighbour_table.STATION, 6), numbers(), filter_row(),
        fixed(listed(MEMBER, N)), rings(), *filtered(), listed(distances.PAIR, (N, N)), waiting()),
    measurement_update.use_pending: lambda: (
        10_000_000, filter_row(), listed(MEMBER, N), rings(), *filtered(),
        listed(distances.PAIR, (N, N)), waiting(), some(N, 2, size=5.0), some(N, N), np.abs(some(N, N))),
    kernels.predict: lambda: (
        *filtered(), listed(MEMBER, N), 0.01, RNG.uniform(0.0, 0.5), 0.04, 100.0, 60.0),
    kernels.student_weight: lambda: (RNG.uniform(0.0, 50.0),),
    kernels.fuse_fix: lambda: (*filtered(), 1, some(3), 0.05, 700.0),
    kernels.fuse_range: lambda: (
        *filtered(), some(5 * N), some(N, 2, size=5.0), 0, 2, some(3, size=6.0), 6.0, 0.01, -1.0, 1.0),
    uncertainty.relative_variance: lambda: (cov(), 0, 1, some(3)),
    uncertainty.relative_stds: lambda: (cov(), 0, some(N, 3, size=6.0), flags(), 0.01, np.zeros(N)),
    uncertainty.variance_between: lambda: (cov(), 0, 1, listed(MEMBER, N), some(5 * N)),
    uncertainty.seen_from: lambda: (
        1, 10_000_000, listed(MEMBER, N), 0.5, *filtered(), 9_500_000, 0.01, 0.3, -0.2,
        listed(uncertainty.SEEN, N)),
    uncertainty.shape_variance: lambda: (some(N, 3, size=6.0), cov(), np.arange(N)),
    uncertainty.bend: lambda: (
        some(N, 2, size=6.0), some(N, 2, size=6.0), cov(), np.arange(N), np.zeros((N, N)), np.zeros((N, N))),
    formation_control.join: lambda: (
        some(3), some(3), some(3), some(3, 3), 0, 2, 1.0, 0.05, bool(RNG.integers(2))),
    formation_control.follow: lambda: (
        some(3, 3, size=2.0), flags()[:2], some(4, 3), bool(RNG.integers(2)), 1.5, 0.05),
    avoidance.velocity_change: lambda: (
        0, 10_000_000, listed(uncertainty.SEEN, N), some(6, 3, size=3.0), some(6, 3), kept(), 0.5, 1.2,
        some(5)),
    avoidance.keep_clear: lambda: (
        0, some(N, 3, size=3.0), some(N, 3), flags(), np.abs(some(N)), np.full(N, 3.0), 0.5, 1.2, some(3),
        some(3), some(2), some(3), np.zeros(2)),
    avoidance.remember: lambda: (
        10_000_000, 2, bool(RNG.integers(2)), some(N, 3), some(N, 3), some(N), some(N, 3), some(N, 3),
        kept()),
}  # fmt: skip


def results(kernel, arguments):
    own = [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]
    returned = kernel(*own)
    return [0.0 if returned is None else returned, *own]


@pytest.mark.parametrize("kernel", CASES, ids=lambda kernel: kernel.__name__)
def test_interpreted_and_compiled_kernels_give_equal_bits(kernel):
    for _ in range(100):
        arguments = CASES[kernel]()
        for compiled, interpreted in zip(
            results(kernel, arguments), results(getattr(kernel, "py_func", kernel), arguments), strict=True
        ):
            np.testing.assert_array_equal(compiled, interpreted, strict=False)

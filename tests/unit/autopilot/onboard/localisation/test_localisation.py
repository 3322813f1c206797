"""The cooperative localisation against the Cramer-Rao bound, the batch optimum and its own covariance."""

import numpy as np
import pytest
from beacons import Beacon, decode, encode
from onboard_world import article_places_ned_m, rms, shape_errors_m
from scipy.optimize import least_squares

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation import kernels
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.localisation.tracks import SAMPLES
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.neighbour_table import NeighbourTable
from autopilot.parameters.config import REMEMBERED_S

PLACES = article_places_ned_m()
N = len(PLACES)
PAIRS = [(i, j) for i in range(N) for j in range(N) if i != j]
RANGE_STD_M = 0.1
STATIC = LocalisationModel(
    gps_bias_std_m=1.5, gps_bias_time_constant_s=1e6, gps_white_std_m=0.2, odometry_drift_m_sqrt_s=1e-4,
    height_std_m=0.01, height_time_constant_s=1e6, range_floor_std_m=1e-3,
)  # fmt: skip
FIXES = 25


class StaticCase:
    """UAVs at rest for 5 s near their places: fixes at 5 Hz with constant bias, five rounds of distances."""

    def __init__(self, seed, *, rounds=5, placement_std_m=0.5, mirrored=False):
        rng = np.random.default_rng(seed)
        self.truth = PLACES + np.pad(rng.normal(0.0, placement_std_m, (N, 2)), ((0, 0), (0, 1)))
        self.bias = rng.normal(0.0, STATIC.gps_bias_std_m, (N, 2))
        if mirrored:
            # The worst GPS errors: they show the formation's two rows exchanged.
            self.bias = np.column_stack((-2.0 * self.truth[:, 0], np.zeros(N)))
        self.fixes = self.truth[:, :2] + self.bias + rng.normal(0.0, STATIC.gps_white_std_m, (FIXES, N, 2))
        self.ranges = []
        for k in range(rounds):
            for m in rng.permutation(len(PAIRS)):
                i, j = PAIRS[m]
                distance_m = np.linalg.norm(self.truth[i] - self.truth[j]) + rng.normal(0.0, RANGE_STD_M)
                self.ranges.append((i, j, round((k + len(self.ranges) % 56 / 56) * 1e6) + 1_000, distance_m))

    def run(self, model=STATIC):
        """Return the filter after all data, fed in order of time."""
        filter_ = CooperativeLocalisation(own=0, places_ned_m=PLACES, model=model)
        ranges = iter(self.ranges)
        item = next(ranges)
        for now_us in range(0, 5_100_000, 100_000):
            for j in range(N):
                # The origin of odometry is arbitrary: here it is the site's plus the station's number.
                filter_.on_odometry(j, now_us, (float(j), 0.0, PLACES[j, 2]), (0.0, 0.0, 0.0))
                if now_us % 200_000 == 0 and now_us // 200_000 < FIXES:
                    filter_.on_fix(j, now_us, (*self.fixes[now_us // 200_000, j], 0.0))
            while item is not None and item[2] <= now_us:
                filter_.on_range(*item, RANGE_STD_M, now_us=now_us)
                item = next(ranges, None)
            filter_.update(now_us)
        return filter_

    def batch(self):
        """Return the maximum a posteriori positions (N, 2) of the same data, by scipy from the truth."""
        mean_fix = self.fixes.mean(axis=0)
        fix_std_m = np.hypot(STATIC.gps_bias_std_m, STATIC.gps_white_std_m / np.sqrt(FIXES))
        i, j = np.array([item[0] for item in self.ranges]), np.array([item[1] for item in self.ranges])
        measured = np.array([item[3] for item in self.ranges])

        def residuals(flat):
            pos = flat.reshape(N, 2)
            expected = np.linalg.norm(pos[i] - pos[j], axis=1)
            return np.concatenate(
                (((pos - mean_fix) / fix_std_m).ravel(), (expected - measured) / RANGE_STD_M)
            )

        return least_squares(residuals, self.truth[:, :2].ravel()).x.reshape(N, 2)


def positions(filter_):
    return filter_.positions_ned_m(5_000_000)[:, :2]


def bound(pos, rounds):
    """Return (16, 16) the inverse Fisher information of horizontal positions: GPS as prior, and distances."""
    fix_var = STATIC.gps_bias_std_m**2 + STATIC.gps_white_std_m**2 / FIXES
    information = np.eye(2 * N) / fix_var
    for i, j in PAIRS:
        row = np.zeros(2 * N)
        row[2 * i : 2 * i + 2] = (pos[i] - pos[j]) / np.linalg.norm(pos[i] - pos[j])
        row[2 * j : 2 * j + 2] = -row[2 * i : 2 * i + 2]
        information += rounds * np.outer(row, row) / RANGE_STD_M**2
    return np.linalg.inv(information)


def pose_modes(pos):
    """Return (16, 3), orthonormal: displacements by two shifts and a small turn of the formation."""
    centred = pos - pos.mean(axis=0)
    turn = np.column_stack((-centred[:, 1], centred[:, 0])).ravel()
    north, east = np.tile((1.0, 0.0), N), np.tile((0.0, 1.0), N)
    return np.column_stack((north / np.sqrt(N), east / np.sqrt(N), turn / np.linalg.norm(turn)))


def shape_projector(pos):
    """Return the (16, 16) projector onto the displacements that a rigid alignment leaves."""
    modes = pose_modes(pos)
    return np.eye(2 * N) - modes @ modes.T


@pytest.fixture(scope="module")
def monte_carlo():
    cases = [StaticCase(seed) for seed in range(100)]
    return [(case, case.run()) for case in cases]


def test_shape_error_is_within_a_tenth_of_the_cramer_rao_bound(monte_carlo):
    found, bounds = [], []
    for case, filter_ in monte_carlo:
        pos = case.truth[:, :2]
        projector = shape_projector(pos)
        bounds.append(np.sqrt(np.trace(projector @ bound(pos, 5) @ projector) / N))
        found.append(rms(shape_errors_m(positions(filter_), pos)))
    # 100 runs of 13 degrees of freedom: the ratio's own scatter is 1 / sqrt(2 * 1300) = 2 %.
    assert 0.9 < rms(found) / rms(bounds) < 1.1


def test_errors_are_consistent_with_the_covariance(monte_carlo):
    """Shape and pose separately: a turn of the whole is an arc, which no Cartesian Gaussian describes."""
    shape_nees, pose_nees = [], []
    for case, filter_ in monte_carlo:
        keep = (np.arange(N)[:, None] * kernels.STATES + np.arange(2)).ravel()
        cov = filter_.cov[np.ix_(keep, keep)]
        truth, found = case.truth[:, :2], positions(filter_)
        centred, seen = truth - truth.mean(axis=0), found - found.mean(axis=0)
        angle = np.arctan2(
            np.sum(centred[:, 0] * seen[:, 1] - centred[:, 1] * seen[:, 0]), np.sum(centred * seen)
        )
        turn = np.array(((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
        q, projector = pose_modes(found), shape_projector(found)
        error = projector @ (seen - centred @ turn).ravel()
        shape_nees.append(error @ np.linalg.pinv(projector @ cov @ projector, rcond=1e-6) @ error)
        shift_m = found.mean(axis=0) - truth.mean(axis=0)
        pose = np.array((*(shift_m * np.sqrt(N)), angle * np.linalg.norm(centred)))
        pose_nees.append(pose @ np.linalg.solve(q.T @ cov @ q, pose))
    # Means of 100 chi-squares with 13 and 3 degrees of freedom: 95 % within 1.96 sqrt(2 dof / 100).
    assert 13.0 - 1.0 < np.mean(shape_nees) < 13.0 + 1.0
    assert 3.0 - 0.48 < np.mean(pose_nees) < 3.0 + 0.48


def test_it_agrees_with_the_batch_optimum(monte_carlo):
    shape_apart, apart = [], []
    for case, filter_ in monte_carlo[:10]:
        optimum = case.batch()
        apart.append(rms(np.linalg.norm(positions(filter_) - optimum, axis=1)))
        shape_apart.append(rms(shape_errors_m(positions(filter_), optimum)))
    # Sequential fusion with outlier weights adds less than a third of the optimum's own shape error of 0.07
    # m. With GPS weighted by its misfit it adds less than a third of the position error of the whole of 0.53
    # m.
    assert rms(shape_apart) < 0.025
    assert rms(apart) < 0.53 / 3.0


def test_predicted_shape_error_is_that_of_the_bound(monte_carlo):
    case, filter_ = monte_carlo[0]
    projector = shape_projector(case.truth[:, :2])
    expected_m = np.sqrt(np.trace(projector @ bound(case.truth[:, :2], 5) @ projector) / N)
    assert filter_.shape_std_m(5_000_000) == pytest.approx(expected_m, rel=0.15)


def test_covariance_stays_symmetric_and_positive(monte_carlo):
    for _, filter_ in monte_carlo:
        assert np.array_equal(filter_.cov, filter_.cov.T)
        assert np.linalg.eigvalsh(filter_.cov).min() > 0.0


def test_gps_that_shows_the_mirror_image_does_not_flip_the_formation():
    case = StaticCase(7, placement_std_m=0.3, mirrored=True)
    filter_ = case.run()
    assert rms(shape_errors_m(positions(filter_), case.truth[:, :2])) < 0.15
    north_m = positions(filter_)[:, 0]
    assert np.all(north_m[:4] < north_m[4:])  # rows 0..3 are south of rows 4..7, as placed


def test_one_distance_off_by_5_m_moves_nothing_by_more_than_5_cm():
    case = StaticCase(11)
    clean = positions(case.run())
    for k in (100, 279):
        spoilt = StaticCase(11)
        i, j, time_us, distance_m = spoilt.ranges[k]
        spoilt.ranges[k] = (i, j, time_us, distance_m + 5.0)
        moved_m = np.linalg.norm(positions(spoilt.run()) - clean, axis=1)
        assert moved_m.max() < 0.05


def test_a_uav_that_measures_5_m_too_much_does_not_bend_the_others():
    case = StaticCase(12)
    honest = positions(case.run())
    case.ranges = [(i, j, t, d + (5.0 if i == 3 else 0.0)) for i, j, t, d in case.ranges]
    found = positions(case.run())
    others = [k for k in range(N) if k != 3]
    assert rms(shape_errors_m(found[others], honest[others])) < 0.1


def test_a_distance_is_used_once_even_if_repeated():
    case = StaticCase(13, rounds=1)
    filter_ = case.run()
    used, cov = filter_.count_of("ranges_used"), filter_.cov.copy()
    assert used == 56
    for item in case.ranges:
        filter_.on_range(*item, RANGE_STD_M, now_us=5_000_000)
    filter_.update(5_000_000)
    assert filter_.count_of("ranges_used") == used
    assert np.array_equal(filter_.cov, cov)


def test_a_distance_from_the_future_is_rejected_and_does_not_suppress_others():
    filter_ = StaticCase(14).run()
    used = filter_.count_of("ranges_used")
    filter_.on_range(1, 2, 900_000_000, 8.5, 0.1, now_us=5_000_000)
    filter_.on_range(1, 2, 4_990_000, 8.5, 0.1, now_us=5_000_000)
    filter_.update(5_000_000)
    assert filter_.count_of("ranges_used") == used + 1


def moving_filter():
    """Return a filter of two located UAVs, the second flying east at 3 m/s; odometry every 100 ms for 2 s."""
    model = LocalisationModel(gps_bias_std_m=0.02, gps_white_std_m=0.01, odometry_drift_m_sqrt_s=0.01)
    filter_ = CooperativeLocalisation(
        own=0, places_ned_m=np.array([(0.0, 0.0, -5.0), (0.0, 10.0, -5.0)]), model=model
    )
    for time_us in range(0, 2_000_001, 100_000):
        east_m = 10.0 + 3e-6 * time_us
        filter_.on_odometry(0, time_us, (0.0, 0.0, -5.0), (0.0, 0.0, 0.0))
        filter_.on_odometry(1, time_us, (0.0, east_m, -5.0), (0.0, 3.0, 0.0))
        filter_.on_fix(0, time_us, (0.0, 0.0, -5.0))
        filter_.on_fix(1, time_us, (0.0, east_m, -5.0))
    filter_.on_range(0, 1, 1_000_000, 13.0, 0.05, now_us=2_000_000)
    filter_.update(2_000_000)
    assert filter_.located.all()
    return filter_


def test_a_late_distance_is_compared_with_the_positions_of_its_time():
    # 0.45 s old: compared with the present positions it would be 1.35 m too short.
    filter_ = moving_filter()
    filter_.on_range(1, 0, 1_550_000, 10.0 + 3.0 * 1.55, 0.05, now_us=2_000_000)
    before = filter_.state.copy()
    filter_.update(2_000_000)
    assert filter_.count_of("ranges_used") == 2
    assert np.abs(filter_.state - before).max() < 1e-3


def test_a_distance_waits_for_the_odometry_of_its_time():
    filter_ = moving_filter()
    filter_.on_range(0, 1, 2_050_000, 16.15, 0.05, now_us=2_060_000)
    filter_.update(2_060_000)
    assert filter_.count_of("ranges_used") == 1
    filter_.on_odometry(0, 2_100_000, (0.0, 0.0, -5.0), (0.0, 0.0, 0.0))
    filter_.on_odometry(1, 2_100_000, (0.0, 16.3, -5.0), (0.0, 3.0, 0.0))
    filter_.update(2_100_000)
    assert filter_.count_of("ranges_used") == 2


def test_a_wrong_arrangement_is_detected_and_initialised_again():
    case = StaticCase(15)
    filter_ = case.run()
    # Two UAVs are exchanged in the filter's state, with a small variance.
    swapped = filter_.state.copy()
    for a in range(2):
        offset = filter_.positions_ned_m(5_000_000)[4, a] - filter_.positions_ned_m(5_000_000)[0, a]
        swapped[a] += offset
        swapped[4 * kernels.STATES + a] -= offset
    filter_.state[:] = swapped
    for k in range(1, 61):
        now_us = 5_000_000 + k * 100_000
        for j in range(N):
            filter_.on_odometry(j, now_us, (float(j), 0.0, PLACES[j, 2]), (0.0, 0.0, 0.0))
        for i, j in PAIRS[(k * 6) % 56 : (k * 6) % 56 + 6]:
            filter_.on_range(
                i, j, now_us, np.linalg.norm(case.truth[i] - case.truth[j]), RANGE_STD_M, now_us=now_us
            )
        filter_.update(now_us)
    found = filter_.positions_ned_m(11_000_000)[:, :2]
    assert rms(shape_errors_m(found, case.truth[:, :2])) < 0.15


def drawn_beacon(rng, case, row, now_us):
    """Return a beacon of station row + 10 with new, old and late content, and unknown peers."""
    peers = rng.permutation([j for j in range(N + 3) if j != row])[: rng.integers(0, N)]
    fix_us = now_us - rng.integers(-20, 300) * 1_000
    jump_m = 3.0 * (rng.random() < 0.02)
    return Beacon(
        station=row + 10, seq=0, time_us=int(now_us - rng.integers(0, 150_000)), phase=FlightPhase.JOINING,
        odometry_ned_m=(row + jump_m, 0.0, PLACES[row, 2]), vel_ned_m_s=(0.0, 0.0, 0.0),
        fix=None if rng.random() < 0.1 else Fix(
            int(fix_us) // 1_000, (*(case.truth[row, :2] + case.bias[row]), 0.0),
            None if rng.random() < 0.5 else 2.5, None if rng.random() < 0.5 else 3.5),
        distances=tuple(
            wire.Distance(int(j) + 10, int(now_us - rng.integers(-50_000, 1_500_000)) // 1_000, float(
                np.linalg.norm(case.truth[row] - case.truth[j % N])), 0.1) for j in peers),
    )  # fmt: skip


def test_processing_a_beacon_equals_processing_its_parts():
    """Eight of thirteen received UAVs are localised, from 5 s on, with half a minute of silence."""
    rng, case = np.random.default_rng(18), StaticCase(18)
    one_by_one, at_once = case.run(), case.run()
    table = NeighbourTable(station=10, stations=N + 13, period_us=3_600_000_000, gps_std_m=1.0)
    table.rows = np.array([*(10 * [-1]), *range(N), *(3 * [-1])])
    for now_us in (*range(5_100_000, 9_000_000, 30_000), *range(40_000_000, 44_000_000, 30_000)):
        row = int(rng.integers(1, N))
        payload = encode(drawn_beacon(rng, case, row, now_us))
        table.pages.put(row + 10, payload)
        at_once.read(table, now_us)
        beacon = decode(payload)
        one_by_one.on_odometry(row, beacon.time_us, beacon.odometry_ned_m, beacon.vel_ned_m_s)
        if beacon.fix is not None and beacon.fix.time_ms * 1_000 <= now_us:
            fix = beacon.fix
            one_by_one.on_fix(row, fix.time_ms * 1_000, fix.pos_ned_m, fix.std_h_m, fix.std_v_m)
        for item in beacon.distances:
            if item.peer < 10 + N:
                time_us = item.time_ms * 1_000
                one_by_one.on_range(row, item.peer - 10, time_us, item.distance_m, item.std_m, now_us=now_us)
        for filter_ in (one_by_one, at_once):
            filter_.on_odometry(0, now_us, (0.0, 0.0, PLACES[0, 2]), (0.0, 0.0, 0.0))
            filter_.update(now_us)
        assert np.array_equal(at_once.members, one_by_one.members)
        assert np.array_equal(at_once.cov, one_by_one.cov)
    assert np.array_equal(at_once.state, one_by_one.state)
    assert (table.bad_beacons, table.pages.count) == (0, 0)
    assert at_once.count_of("ranges_used") == one_by_one.count_of("ranges_used") > 300
    assert at_once.count_of("ranges_too_late") == one_by_one.count_of("ranges_too_late") > 0
    assert at_once.odometry_jumps == one_by_one.odometry_jumps > 0


def test_no_distance_is_lost_while_many_wait_for_odometry():
    case = StaticCase(18)
    filter_ = case.run()
    before, now_us = filter_.count_of("ranges_used"), 5_900_000
    for k in range(100):
        for i, j in PAIRS:
            distance_m = float(np.linalg.norm(case.truth[i] - case.truth[j]))
            filter_.on_range(i, j, 5_001_000 + 1_000 * k, distance_m, RANGE_STD_M, now_us=now_us)
    filter_.update(now_us)
    assert filter_.count_of("ranges_used") == before
    for j in range(N):
        filter_.on_odometry(j, now_us, (float(j), 0.0, PLACES[j, 2]), (0.0, 0.0, 0.0))
    filter_.update(now_us)
    assert filter_.count_of("ranges_used") == before + 100 * len(PAIRS)
    assert filter_.count_of("ranges_too_late") == 0


def test_the_gps_error_is_that_of_the_receiver():
    case = StaticCase(19)
    filter_ = case.run()
    for station in range(N):
        error_ned_m, std_m = filter_.gps_error(station)
        # Known up to the error of the mean of eight, 1.5 / sqrt(8) per axis, and of the heading.
        assert 0.4 < std_m < 0.9
        assert np.abs(error_ned_m[:2] - case.bias[station]).max() < 4.0 * std_m
        # The GPS height is 0, the barometer exact.
        assert error_ned_m[2] == pytest.approx(-PLACES[station, 2], abs=0.1)


def test_a_uav_that_is_not_located_has_no_distance_variance_and_a_prior_gps_error():
    filter_ = CooperativeLocalisation(own=0, places_ned_m=PLACES, model=STATIC)
    assert filter_.distance_variance_m2(1, 0) is None
    error_ned_m, std_m = filter_.gps_error(1)
    assert not any(error_ned_m)
    assert std_m == pytest.approx(1.5)


def test_a_receiver_that_states_a_worse_accuracy_has_less_weight():
    """One of two UAVs states 6 m: their mean place is then the other's, by 1 / (1 + (6 / 1.5)^2)."""
    model = LocalisationModel(gps_bias_std_m=1.5, gps_white_std_m=0.01, gps_bias_time_constant_s=1e6)
    found = []
    for stated_m in (None, 6.0):
        filter_ = CooperativeLocalisation(
            own=0, places_ned_m=np.array([(0.0, 0.0, -5.0), (0.0, 10.0, -5.0)]), model=model
        )
        for time_us in range(0, 2_000_001, 100_000):
            for j in range(2):
                filter_.on_odometry(j, time_us, (0.0, 10.0 * j, -5.0), (0.0, 0.0, 0.0))
            filter_.on_fix(0, time_us, (0.0, 0.0, -5.0))
            filter_.on_fix(1, time_us, (0.0, 11.0, -5.0), stated_m, stated_m)
        filter_.on_range(0, 1, 1_000_000, 10.0, 0.01, now_us=2_000_000)
        filter_.update(2_000_000)
        assert filter_.located.all()
        found.append(filter_.positions_ned_m(2_000_000)[0, 1])
    assert found[0] == pytest.approx(0.5, abs=0.05)
    assert found[1] == pytest.approx(1.0 / 17.0, abs=0.02)


def test_the_weight_of_gps_height_follows_its_spectrum():
    """Barometer 0.2 m, GPS of 2.5 m and 60 s once a second: the gain in the height is below 1 %."""
    model = LocalisationModel()
    state, cov = np.zeros(5), np.diag((2.0, 2.0, model.height_std_m**2, 2.25, 2.25))
    for _ in range(60):
        kernels.fuse_fix(state, cov, 0, np.array((0.0, 0.0, 2.5)), 0.04, 2.5**2 * 2.0 * 60.0)
    # Over a minute, one time constant: information 60 / 750 against 1 / 0.04.
    assert cov[2, 2] == pytest.approx(1.0 / (1.0 / 0.04 + 60.0 / 750.0), rel=1e-6)
    assert 0.0 < state[2] < 0.01


def test_distances_older_than_the_odometry_history_are_counted():
    """The own track holds 64 samples: 2.1 s at 30 Hz, which scenarios rely on."""
    assert SAMPLES / 30.0 >= REMEMBERED_S
    filter_ = CooperativeLocalisation(own=0, places_ned_m=PLACES, model=STATIC)
    for k in range(150):
        for j in range(N):
            filter_.on_odometry(j, k * 33_333, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    now_us = 149 * 33_333
    filter_.on_range(0, 1, now_us - 3_000_000, 8.5, RANGE_STD_M, now_us=now_us)
    filter_.update(now_us)
    assert filter_.count_of("ranges_too_late") == 1
    filter_.on_range(0, 1, now_us - 1_000_000, 8.5, RANGE_STD_M, now_us=now_us)
    filter_.update(now_us)
    assert filter_.count_of("ranges_too_late") == 1  # that one waits for GPS


def test_a_distance_of_a_distrusted_uav_gives_no_support():
    filter_ = StaticCase(3).run()
    assert filter_.located.all()
    known_us, now_us = filter_.own_range_us, 5_100_000
    for j in range(N):
        filter_.on_odometry(j, now_us, (float(j), 0.0, PLACES[j, 2]), (0.0, 0.0, 0.0))
    filter_.members["distrusted"][1] = True
    distance_m = float(np.linalg.norm(positions(filter_)[0] - positions(filter_)[1]))
    filter_.on_range(1, 0, now_us - 1_000, distance_m, RANGE_STD_M, now_us=now_us)
    filter_.update(now_us)
    assert filter_.own_range_us == known_us
    filter_.on_range(0, 1, now_us - 1_000, distance_m, RANGE_STD_M, now_us=now_us)
    filter_.update(now_us)
    assert filter_.own_range_us == now_us - 1_000


def test_variances_of_distance_and_line_are_those_of_the_covariance():
    filter_ = StaticCase(20).run()
    now_us, peer = 5_400_000, 6
    between_m = filter_.positions_ned_m(now_us)[0] - filter_.positions_ned_m(now_us)[peer]
    own, other = np.arange(3), kernels.STATES * peer + np.arange(3)
    block = filter_.cov[np.ix_(own, own)] + filter_.cov[np.ix_(other, other)]
    block -= filter_.cov[np.ix_(own, other)] + filter_.cov[np.ix_(other, own)]
    walked_m2 = 2.0 * STATIC.odometry_drift_m_sqrt_s**2 * (now_us - filter_._time_us) * 1e-6
    line = between_m / np.linalg.norm(between_m)
    variance_m2 = filter_.distance_variance_m2(peer, now_us)
    assert variance_m2 == pytest.approx(line @ block @ line + walked_m2, rel=1e-9)
    assert 0.0 < variance_m2 < RANGE_STD_M**2  # ten measurements of the pair, and the others'
    level = line * (1.0, 1.0, 0.0) / np.hypot(line[0], line[1])
    others = filter_.others(now_us, fresh_us=1_000_000)
    assert others["std_m"][peer] == pytest.approx(np.sqrt(level @ block @ level + walked_m2), rel=1e-9)
    assert others["fresh"].all()
    assert not filter_.others(now_us, fresh_us=100_000)["fresh"].any()


def test_compiled_and_interpreted_kernels_agree():
    filter_ = StaticCase(16, rounds=2).run()
    odometry_m = np.array((2.5, 0.1, 0.0))
    results = []
    for function in (kernels.fuse_range, getattr(kernels.fuse_range, "py_func", kernels.fuse_range)):
        state, cov = filter_.state.copy(), filter_.cov.copy()
        weight = function(state, cov, state, PLACES[:, :2].copy(), 4, 0, odometry_m, 2.7, 0.01, -1.0, 1.0)
        results.append((weight, state, cov))
    assert results[0][0] == pytest.approx(results[1][0], rel=1e-12)
    assert results[0][1] == pytest.approx(results[1][1], rel=1e-9, abs=1e-12)
    assert results[0][2] == pytest.approx(results[1][2], rel=1e-9, abs=1e-12)

"""Posterior Cramer-Rao bound of the cooperative localisation.

It is a lower bound of the mean squared error of all estimators that use odometry as the motion up to drift.
For a linear random motion with Gaussian noise it obeys the recursion of Tichavsky, Muravchik and Nehorai
("Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE Trans. Signal Processing 46, 1998,
eq. 21): J' = (Q + F J^-1 F')^-1 + sum H' R^-1 H, with the true derivatives H of the measurements. It is
computed for the inverse J^-1 with the matrix inversion lemma. The expectation over the motion is replaced by
the simulated motion.
"""

from collections import defaultdict

import numpy as np

from studies.codesign.simulated import GRID_US, Array, Ranged, SimulatedFlight

PER_UAV = 6
"""Offset north, east, down; GPS bias north, east, down."""
_FLAT_M2 = 1e6
"""Prior variance of unknown states."""


def posterior_bound(flight: SimulatedFlight) -> Array:
    """Return the bound (2N, 2N) of the covariance of the horizontal offsets (n0, e0, n1, ...) at the end.

    It is based on all measurements that the UAV has received by the end of the flight.
    """
    model = flight.model
    count = len(flight.places_ned_m)
    size = PER_UAV * count
    dt_s = GRID_US * 1e-6
    height_kept = np.exp(-dt_s / model.height_time_constant_s)
    bias_kept = np.exp(-dt_s / model.gps_bias_time_constant_s)
    kept = np.tile((1.0, 1.0, height_kept, bias_kept, bias_kept, bias_kept), count)
    drift_m2 = model.odometry_drift_m_sqrt_s**2 * dt_s
    height_m2 = model.height_std_m**2
    bias_m2 = np.array((model.gps_bias_std_m, model.gps_bias_std_m, model.gps_bias_vertical_std_m)) ** 2
    added = np.tile(
        (drift_m2, drift_m2, height_m2 * (1.0 - height_kept**2), *(bias_m2 * (1.0 - bias_kept**2))), count
    )
    cov = np.diag(np.tile((_FLAT_M2, _FLAT_M2, height_m2, *bias_m2), count))

    fixes, distances = flight.known()
    fixes_at, distances_at = defaultdict[int, list[int]](list), defaultdict[int, list[Ranged]](list)
    for time_us, station in fixes:
        fixes_at[time_us // GRID_US].append(station)
    for item in distances:
        distances_at[item.time_us // GRID_US].append(item)
    for at in range(len(flight.pos_ned_m)):
        if at:
            cov *= np.outer(kept, kept)
            cov[np.diag_indices(size)] += added
        rows, variances = [], []
        for station in fixes_at[at]:
            for a in range(3):
                row = np.zeros(size)
                row[PER_UAV * station + a] = row[PER_UAV * station + 3 + a] = 1.0
                rows.append(row)
                variances.append(model.gps_white_std_m**2)
        for item in distances_at[at]:
            between_m = flight.pos_ned_m[at, item.initiator] - flight.pos_ned_m[at, item.responder]
            row = np.zeros(size)
            row[PER_UAV * item.initiator : PER_UAV * item.initiator + 3] = between_m
            row[PER_UAV * item.responder : PER_UAV * item.responder + 3] = -between_m
            rows.append(row / np.linalg.norm(between_m))
            variances.append(item.std_m**2 + model.range_floor_std_m**2)
        if rows:
            jacobian = np.array(rows)
            gain = cov @ jacobian.T
            cov -= gain @ np.linalg.solve(jacobian @ gain + np.diag(variances), gain.T)
            cov = 0.5 * (cov + cov.T)
    horizontal = (PER_UAV * np.arange(count)[:, np.newaxis] + np.arange(2)).ravel()
    return np.asarray(cov[np.ix_(horizontal, horizontal)])


def shape_basis(pos_ned_m: Array) -> Array:
    """Return an orthonormal basis (2N, 2N - 3) of changes of horizontal positions without rigid motion.

    It is orthogonal to two translations and a small rotation of the formation. Positions are in the order
    (n0, e0, n1, ...); pos_ned_m (N, 3).
    """
    count = len(pos_ned_m)
    centred = pos_ned_m[:, :2] - pos_ned_m[:, :2].mean(axis=0)
    turn = np.column_stack((-centred[:, 1], centred[:, 0])).ravel()
    pose = np.column_stack((np.tile((1.0, 0.0), count), np.tile((0.0, 1.0), count), turn))
    basis, _ = np.linalg.qr(pose, mode="complete")
    return np.asarray(basis[:, 3:])


def aligned_error_m(found_m: Array, truth_m: Array) -> Array:
    """Return the error (N, 2) of horizontal positions after the best rigid alignment with the true ones.

    The frame is that of the truth. Closed form of Kabsch's problem in the plane, with north + j east.
    """
    found = (found_m[:, 0] - found_m[:, 0].mean()) + 1j * (found_m[:, 1] - found_m[:, 1].mean())
    truth = (truth_m[:, 0] - truth_m[:, 0].mean()) + 1j * (truth_m[:, 1] - truth_m[:, 1].mean())
    error = found * np.exp(-1j * np.angle(np.vdot(truth, found))) - truth
    return np.column_stack((error.real, error.imag))

"""Batch optimum: least-squares positions of the formation from all fixes and the most recent distances.

It is the reference for the recursive filter. Unknown are the UAVs' offsets at the end; the odometry drift
between a measurement and the end is noise, which is correlated between measurements.
"""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from studies.codesign.simulated import GRID_US, Array, SimulatedFlight

FIX_GROUP_US = 1_000_000
"""Fixes within this time are averaged: the changes of odometry and bias are smaller than their noise."""
RANGE_WINDOW_US = 4_000_000
"""Older distances are skipped: their odometry drift is too large for the first order. With the defaults of
`LocalisationModel` a distance of this age has a variance of 2 (0.1)^2 4 + 0.03^2 + 0.05^2 = 0.083 m^2, and
thus a 25th of the information of one at the end with 0.0034 m^2."""


def batch_optimum(flight: SimulatedFlight) -> Array:
    """Return the maximum a posteriori horizontal offsets (N, 2) at the end of the flight, m.

    Generalised least squares with scipy, started at the truth; the Cholesky factor of the covariance whitens
    the residuals. With the odometry's random walk w from a measurement to the end, a distance is
    |p_i + w_i - p_j - w_j|, in first order with the walks along the line between the two; a fix is
    p_i + w_i + bias.
    """
    model = flight.model
    count = len(flight.places_ned_m)
    end = len(flight.pos_ned_m) - 1
    fixes, distances = flight.known()
    groups: dict[tuple[int, int], list[int]] = {}
    for time_us, station in fixes:
        groups.setdefault((station, time_us // FIX_GROUP_US), []).append(time_us // GRID_US)
    times, lines, measured, between_m, own_variance, biased = [], [], [], [], [], []
    distances = [item for item in distances if item.time_us > flight.end_us - RANGE_WINDOW_US]
    for item in distances:
        at = item.time_us // GRID_US
        line = np.zeros((count, 2))
        apart_m = flight.pos_ned_m[at, item.initiator] - flight.pos_ned_m[at, item.responder]
        line[item.initiator] = apart_m[:2] / np.linalg.norm(apart_m)
        line[item.responder] = -line[item.initiator]
        odometry_m = flight.odometry_ned_m[at]
        times.append(at)
        lines.append(line.ravel())
        measured.append(item.distance_m)
        between_m.append(odometry_m[item.initiator] - odometry_m[item.responder])
        own_variance.append(item.std_m**2 + model.range_floor_std_m**2)
        biased.append(False)
    for (station, _), at_all in groups.items():
        for a in range(2):
            line = np.zeros((count, 2))
            line[station, a] = 1.0
            difference_m = flight.fix_ned_m[at_all, station, a] - flight.odometry_ned_m[at_all, station, a]
            times.append(round(float(np.mean(at_all))))
            lines.append(line.ravel())
            measured.append(float(difference_m.mean()))
            own_variance.append(model.gps_white_std_m**2 / len(at_all))
            biased.append(True)

    when, directions, is_fix = np.array(times), np.array(lines), np.array(biased)
    dt_s = GRID_US * 1e-6
    shared_s = (end - np.maximum.outer(when, when)) * dt_s
    covariance = np.diag(own_variance) + model.odometry_drift_m_sqrt_s**2 * shared_s * (
        directions @ directions.T
    )
    apart_s = np.abs(np.subtract.outer(when, when)) * dt_s
    same_axis = np.outer(is_fix, is_fix) * (directions @ directions.T)
    covariance += model.gps_bias_std_m**2 * np.exp(-apart_s / model.gps_bias_time_constant_s) * same_axis
    factor = np.linalg.cholesky(covariance)
    measured_m = np.array(measured)
    ends = np.array([(item.initiator, item.responder) for item in distances])
    odometry_between_m = np.array(between_m)
    level = np.s_[: 2 * count]

    def apart(flat: Array) -> Array:
        offsets_ne_m, heights_m = flat[level].reshape(count, 2), flat[2 * count :]
        apart_m = odometry_between_m.copy()
        apart_m[:, :2] += offsets_ne_m[ends[:, 0]] - offsets_ne_m[ends[:, 1]]
        apart_m[:, 2] += heights_m[ends[:, 0]] - heights_m[ends[:, 1]]
        return apart_m

    def residuals(flat: Array) -> Array:
        expected = np.concatenate((np.linalg.norm(apart(flat), axis=1), directions[is_fix] @ flat[level]))
        whitened = solve_triangular(factor, expected - measured_m, lower=True)
        return np.concatenate((whitened, flat[2 * count :] / model.height_std_m))

    def derivative(flat: Array) -> Array:
        apart_m = apart(flat)
        apart_m /= np.linalg.norm(apart_m, axis=1, keepdims=True)
        rows = np.hstack((directions, np.zeros((len(directions), count))))
        ranged = np.arange(len(ends))
        for sign, end_of in ((1.0, ends[:, 0]), (-1.0, ends[:, 1])):
            for a in range(2):
                rows[ranged, 2 * end_of + a] = sign * apart_m[:, a]
            rows[ranged, 2 * count + end_of] = sign * apart_m[:, 2]
        heights = np.hstack((np.zeros((count, 2 * count)), np.eye(count) / model.height_std_m))
        return np.vstack((solve_triangular(factor, rows, lower=True), heights))

    offsets_m = flight.offsets_ned_m[end]
    start = np.concatenate((offsets_m[:, :2].ravel(), offsets_m[:, 2]))
    solution = least_squares(residuals, start, jac=derivative, method="lm")
    optimum_m: Array = solution.x[level].reshape(count, 2)
    return optimum_m

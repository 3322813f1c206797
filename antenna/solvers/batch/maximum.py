"""Maxima of arrays of point currents between grid directions, by Newton's method on the sphere.

About a direction r with the unit vectors e1, e2 of its tangent plane, r(a, b) = r (1 - (a^2 + b^2) / 2) + a
e1 + b e2 up to the third order, so that the phase of a point p, k p.r(a, b), has the slopes k p.e1 and k p.e2
and the curvatures -k p.r. The gain |N|^2 - |r.N|^2 follows with its first and second derivatives from one
pass over the points.
"""

import math

import numpy as np
from numba import njit

from antenna.analysis.maxima import PEAK_CANDIDATES, grid_loss_db, peaks
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.far_field import Single

ARRIVED_RAD = 1e-5
"""Step at which the search ends; it changes the gain by less than 1e-9, relative, for any array."""
STEPS = 40


@njit(cache=True, nogil=True, error_model="numpy")
def survey_arrays(
    centres_m: Array, points_m: Array, axes: Array, moments: Complex, wavelength_m: float, gain_theta: Single,
    gain_phi: Single, row_weights: Array, maximum: Array, average: Array,
) -> None:  # fmt: skip
    """Write maxima (S, 3), gain_dbi, theta_deg and phi_deg, and average gains (S,) of S arrays.

    Partial gains (S, T, P) are linear, on a grid of `directions_deg`; the average is that of the rows' means
    with ``row_weights`` (T,). A pattern that is zero or not finite has the maximum -inf.
    """
    rows, columns = gain_theta.shape[1], gain_theta.shape[2]
    step_rad = math.pi / (rows - 1)
    k_rad_m = 2.0 * math.pi / wavelength_m
    total = np.empty((rows, columns), np.float32)
    row, column = np.empty(PEAK_CANDIDATES, np.int64), np.empty(PEAK_CANDIDATES, np.int64)
    found = np.empty(3)
    sums = np.empty((6, 3), np.complex128)
    for s in range(len(gain_theta)):
        highest = np.float32(0.0)
        average[s] = 0.0
        for t in range(rows):
            in_row = np.float32(0.0)
            for p in range(columns):
                gain = gain_theta[s, t, p] + gain_phi[s, t, p]
                total[t, p] = gain
                in_row += gain
                highest = max(highest, gain)
            average[s] += row_weights[t] * in_row / columns
        maximum[s] = -np.inf
        if not 0.0 < highest < np.inf:
            continue
        margin_db = grid_loss_db(step_rad, centres_m[s], wavelength_m)
        least = highest * 10.0 ** (-0.1 * margin_db)
        for c in range(peaks(total, least, row, column)):
            ascend(
                points_m[s], axes[s], moments[s], k_rad_m, row[c] * step_rad, column[c] * step_rad, step_rad,
                sums, found,
            )  # fmt: skip
            if found[0] > maximum[s, 0]:
                maximum[s, 0], maximum[s, 1], maximum[s, 2] = found[0], found[1], found[2]
        maximum[s, 0] = 10.0 * math.log10(maximum[s, 0])
        maximum[s, 1], maximum[s, 2] = math.degrees(maximum[s, 1]), math.degrees(maximum[s, 2]) % 360.0


@njit(cache=True, nogil=True, error_model="numpy")
def ascend(
    points_m: Array, axes: Array, moments: Complex, k_rad_m: float, theta_rad: float, phi_rad: float,
    reach_rad: float, sums: Complex, found: Array,
) -> None:  # fmt: skip
    """Write the maximum next to a direction: linear gain, theta_rad, phi_rad.

    Steps are limited to ``reach_rad``, and shortened if the gain would decrease. ``sums`` (6, 3) is a work
    array.
    """
    theta, phi = theta_rad, phi_rad
    gain, slope_a, slope_b, bend_aa, bend_ab, bend_bb = local_gain(
        points_m, axes, moments, k_rad_m, theta, phi, sums
    )
    for _ in range(STEPS):
        determinant = bend_aa * bend_bb - bend_ab * bend_ab
        if bend_aa + bend_bb < 0.0 and determinant > 0.0:
            a = (bend_ab * slope_b - bend_bb * slope_a) / determinant
            b = (bend_ab * slope_a - bend_aa * slope_b) / determinant
        else:
            steepness = math.hypot(slope_a, slope_b)
            if steepness < 1e-12 * gain:
                break
            a, b = slope_a * reach_rad / steepness, slope_b * reach_rad / steepness
        length = math.hypot(a, b)
        if length > reach_rad:
            a, b, length = a * reach_rad / length, b * reach_rad / length, reach_rad
        risen = False
        while length > ARRIVED_RAD:
            at, turn = moved(theta, phi, a, b)
            seen = local_gain(points_m, axes, moments, k_rad_m, at, turn, sums)
            if seen[0] >= gain:
                risen = True
                break
            a, b, length = 0.25 * a, 0.25 * b, 0.25 * length
        if not risen:
            break
        theta, phi = at, turn
        gain, slope_a, slope_b, bend_aa, bend_ab, bend_bb = seen
    found[0], found[1], found[2] = gain, theta, phi


@njit(cache=True, nogil=True, error_model="numpy")
def local_gain(
    points_m: Array, axes: Array, moments: Complex, k_rad_m: float, theta: float, phi: float, sums: Complex
) -> tuple[float, float, float, float, float, float]:
    """Return the linear gain in a direction, its slopes towards larger theta and phi, and its curvatures.

    Per radian: aa, ab, bb with a to the south and b to the east. ``moments`` are scaled so that the gain is
    |N|^2 across the direction.
    """
    st, ct, sp, cp = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    r0, r1, r2 = st * cp, st * sp, ct
    a0, a1, a2 = ct * cp, ct * sp, -st
    b0, b1 = -sp, cp
    sums[:] = 0.0
    for q in range(len(moments)):
        x, y, z = k_rad_m * points_m[q, 0], k_rad_m * points_m[q, 1], k_rad_m * points_m[q, 2]
        along = x * r0 + y * r1 + z * r2
        a = x * a0 + y * a1 + z * a2
        b = x * b0 + y * b1
        f = moments[q] * complex(math.cos(along), math.sin(along))
        fa, fb = complex(-f.imag, f.real) * a, complex(-f.imag, f.real) * b
        bent = complex(-f.imag, f.real) * along
        faa, fab, fbb = -a * a * f - bent, -a * b * f, -b * b * f - bent
        for i in range(3):
            u = axes[q, i]
            sums[0, i] += u * f
            sums[1, i] += u * fa
            sums[2, i] += u * fb
            sums[3, i] += u * faa
            sums[4, i] += u * fab
            sums[5, i] += u * fbb
    n0, n1, n2 = sums[0, 0], sums[0, 1], sums[0, 2]
    on_r = n0 * r0 + n1 * r1 + n2 * r2
    on_a = n0 * a0 + n1 * a1 + n2 * a2
    on_b = n0 * b0 + n1 * b1
    a_r = on_a + sums[1, 0] * r0 + sums[1, 1] * r1 + sums[1, 2] * r2
    b_r = on_b + sums[2, 0] * r0 + sums[2, 1] * r1 + sums[2, 2] * r2
    a_a = sums[1, 0] * a0 + sums[1, 1] * a1 + sums[1, 2] * a2
    a_b = sums[1, 0] * b0 + sums[1, 1] * b1
    b_a = sums[2, 0] * a0 + sums[2, 1] * a1 + sums[2, 2] * a2
    b_b = sums[2, 0] * b0 + sums[2, 1] * b1
    aa_r = 2.0 * a_a - on_r + sums[3, 0] * r0 + sums[3, 1] * r1 + sums[3, 2] * r2
    ab_r = a_b + b_a + sums[4, 0] * r0 + sums[4, 1] * r1 + sums[4, 2] * r2
    bb_r = 2.0 * b_b - on_r + sums[5, 0] * r0 + sums[5, 1] * r1 + sums[5, 2] * r2
    gain = -_product(on_r, on_r)
    slope_a, slope_b = -2.0 * _product(on_r, a_r), -2.0 * _product(on_r, b_r)
    bend_aa = -2.0 * (_product(a_r, a_r) + _product(on_r, aa_r))
    bend_ab = -2.0 * (_product(a_r, b_r) + _product(on_r, ab_r))
    bend_bb = -2.0 * (_product(b_r, b_r) + _product(on_r, bb_r))
    for i in range(3):
        n, na, nb = sums[0, i], sums[1, i], sums[2, i]
        gain += _product(n, n)
        slope_a += 2.0 * _product(n, na)
        slope_b += 2.0 * _product(n, nb)
        bend_aa += 2.0 * (_product(na, na) + _product(n, sums[3, i]))
        bend_ab += 2.0 * (_product(na, nb) + _product(n, sums[4, i]))
        bend_bb += 2.0 * (_product(nb, nb) + _product(n, sums[5, i]))
    return gain, slope_a, slope_b, bend_aa, bend_ab, bend_bb


@njit(cache=True, inline="always", nogil=True)
def _product(first: complex, second: complex) -> float:
    """Return the real part of the product of the first number's conjugate with the second."""
    return first.real * second.real + first.imag * second.imag


@njit(cache=True, nogil=True, error_model="numpy")
def moved(theta: float, phi: float, a: float, b: float) -> tuple[float, float]:
    """Return the direction at offsets a south and b east in the tangent plane of another; radians."""
    outward = math.sin(theta) + a * math.cos(theta)
    x, y = outward * math.cos(phi) - b * math.sin(phi), outward * math.sin(phi) + b * math.cos(phi)
    z = math.cos(theta) - a * math.sin(theta)
    return math.atan2(math.hypot(x, y), z), math.atan2(y, x)

"""Method of moments for the thin wires of one element, as in NEC2.

On a segment of centre c and axis u the current is A + B sin(k s) + C cos(k s), with s along u from c. Current
and slope are continuous between segments. At junctions of several wires the currents sum to zero, and the
charges follow Wu and King. The field is matched at the segments' centres, one wire radius off the axis (Burke
and Poggio, NEC Part I: Program Description - Theory, 1981, II and III).
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import j0, j1

from antenna.model.clearance import SEGMENT_MATCH
from antenna.model.geometry import Array, Complex

ETA_OHM = 376.730313668
"""Impedance of free space."""
_GAUSS_X, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)
_FEW_X, _FEW_WEIGHTS = np.polynomial.legendre.leggauss(2)
FAR_HALVES = 8.0
"""Distance in half-lengths of a segment from which few points suffice to integrate G - 1/R."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight wire segments, in the frame of their element."""

    centres_m: Array
    """(N, 3), like the axes, unit vectors along which currents are positive."""
    axes: Array
    lengths_m: Array
    """(N,), like the radii."""
    radii_m: Array

    def ends_m(self, side: int) -> Array:
        """Return the ends (N, 3) in the direction of the axes (side +1), or the opposite ones (-1)."""
        return np.asarray(self.centres_m + 0.5 * side * self.lengths_m[:, None] * self.axes)


def admittance(segments: Segments, k_rad_m: float) -> tuple[Complex, Array]:
    """Return the admittance matrix, and the expansion of currents on the segments.

    The first (N, N) maps the incident field (V/m) along the axes at the centres to the currents (A) there.
    The second (3, N, N) maps these currents to A, B and C of every segment. A source of V volts on a segment
    of length d is a field of V / d.
    """
    spread = _expansion(segments, k_rad_m)
    fields = fields_of_expansion(segments, segments, k_rad_m)
    impedance = np.einsum("ijc,cjn->in", fields, spread, optimize=True)
    return -np.linalg.inv(impedance), spread


def _expansion(segments: Segments, k_rad_m: float) -> Array:
    """Return A, B and C of the segments, (3, N, N), for 1 A at one centre and 0 at the others."""
    n = len(segments.lengths_m)
    phase = 0.5 * k_rad_m * segments.lengths_m
    rows: list[Array] = []
    for joint in _joints(segments):
        currents, slopes = np.zeros((len(joint), 3, n)), np.zeros((len(joint), 3, n))
        for end, (j, side) in enumerate(joint):
            sine, cosine = side * np.sin(phase[j]), np.cos(phase[j])
            currents[end, :, j] = 1.0, sine, cosine
            slopes[end, :, j] = 0.0, cosine, -sine  # over k
        if len(joint) == 1:  # the current into the flat cap of the wire
            (j, side), ka = joint[0], k_rad_m * segments.radii_m[joint[0][0]]
            rows.append(currents[0] + side * j1(ka) / j0(ka) * slopes[0])
            continue
        sides = np.array([side for _, side in joint], float)
        radii_m = segments.radii_m[[j for j, _ in joint]]
        charges = slopes * (np.log(2.0 / (k_rad_m * radii_m)) - np.euler_gamma)[:, None, None]
        rows.append(np.tensordot(sides, currents, 1))
        rows.extend(charges[1:] - charges[0])
    centres = np.zeros((n, 3, n))
    centres[np.arange(n), 0, np.arange(n)] = centres[np.arange(n), 2, np.arange(n)] = 1.0
    matrix = np.concatenate([np.array(rows), centres]).reshape(3 * n, 3 * n)
    right = np.concatenate([np.zeros((2 * n, n)), np.eye(n)])
    return np.linalg.solve(matrix, right).reshape(3, n, n)


def _joints(segments: Segments) -> list[list[tuple[int, int]]]:
    """Return lists of connected ends (segment, side); every end is in one list."""
    joints: list[list[tuple[int, int]]] = []
    places_m: list[Array] = []
    for side in (-1, 1):
        for j, end_m in enumerate(segments.ends_m(side)):
            near_m = SEGMENT_MATCH * float(segments.lengths_m[j])
            for joint, place_m in zip(joints, places_m, strict=True):
                if np.linalg.norm(place_m - end_m) < near_m:
                    joint.append((j, side))
                    break
            else:
                joints.append([(j, side)])
                places_m.append(end_m)
    return joints


def fields_of_expansion(seen: Segments, driving: Segments, k_rad_m: float) -> Complex:
    """Return the fields (N, M, 3) along the axis at centre i, of A, B and C of segment j, each of 1 A.

    With I'' = -k^2 I except for A, and G = exp(-jkR)/R, R^2 = rho^2 + a^2 + (z - z')^2, integration by parts
    leaves only terms at the segment's ends:  E_z = -j eta/(4 pi k) { [I dG/dz' - I' G] + k^2 A int G dz' },
    E_rho = -j eta/(4 pi k rho) [(z' - z) (I dG/dz' - I' G) + I G]  for sine and cosine, and
    E_rho = j eta/(4 pi k) [dG/drho]  for A.
    """
    fields: Complex = np.empty((len(seen.radii_m), len(driving.radii_m), 3), complex)
    write_fields(
        seen.centres_m, seen.axes, seen.radii_m, driving.centres_m, driving.axes, driving.lengths_m, k_rad_m,
        fields,
    )  # fmt: skip
    return fields


@njit(cache=True, nogil=True, error_model="numpy")
def turn(rotation: Array, offset_m: Array, vectors: Array, turned: Array) -> None:
    """Write rotated and translated vectors (M, 3) into ``turned``."""
    for m in range(len(vectors)):
        for x in range(3):
            turned[m, x] = (
                rotation[x, 0] * vectors[m, 0]
                + rotation[x, 1] * vectors[m, 1]
                + rotation[x, 2] * vectors[m, 2]
            ) + offset_m[x]


@njit(cache=True, nogil=True, error_model="numpy")
def mirror(points_m: Array, axes: Array, below_m: Array, below_axes: Array) -> None:
    """Write the images of points (M, 3), and of the axes of currents there, in the ground at height 0."""
    for m in range(len(points_m)):
        below_m[m, 0], below_m[m, 1], below_m[m, 2] = points_m[m, 0], points_m[m, 1], -points_m[m, 2]
        below_axes[m, 0], below_axes[m, 1], below_axes[m, 2] = -axes[m, 0], -axes[m, 1], axes[m, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def write_fields(
    centres_m: Array, axes: Array, radii_m: Array, driving_centres_m: Array, driving_axes: Array,
    driving_lengths_m: Array, k_rad_m: float, fields: Complex,
) -> None:  # fmt: skip
    """Write `fields_of_expansion` (N, M, 3).

    As in NEC2, the radii are those of the wires on which the field is matched.
    """
    scale = -ETA_OHM / (4.0 * math.pi * k_rad_m)
    for j in range(len(driving_centres_m)):
        half_m = 0.5 * driving_lengths_m[j]
        sine_half, cosine = math.sin(k_rad_m * half_m), math.cos(k_rad_m * half_m)
        for i in range(len(centres_m)):
            along_m = tilt = lean = squared_m2 = 0.0
            for x in range(3):
                between_m = centres_m[i, x] - driving_centres_m[j, x]
                along_m += between_m * driving_axes[j, x]
                lean += between_m * axes[i, x]
                tilt += axes[i, x] * driving_axes[j, x]
                squared_m2 += between_m * between_m
            rho_m = math.sqrt(max(squared_m2 - along_m * along_m, 0.0) + radii_m[i] ** 2)
            lean = (lean - along_m * tilt) / rho_m
            axial_a = axial_b = axial_c = radial_a = radial_b = radial_c = 0.0j
            for side in (1.0, -1.0):
                ahead_m = along_m - side * half_m
                distance_m = math.sqrt(rho_m * rho_m + ahead_m * ahead_m)
                phase = k_rad_m * distance_m
                green = complex(math.cos(phase), -math.sin(phase)) / distance_m
                steep = green * complex(1.0 / distance_m, k_rad_m) / distance_m  # -dG/dR / R
                sine, slope = side * sine_half, steep * ahead_m
                ends_b = sine * slope - k_rad_m * cosine * green
                ends_c = cosine * slope + k_rad_m * sine * green
                axial_a += side * slope
                axial_b += side * ends_b
                axial_c += side * ends_c
                radial_a += side * steep * rho_m
                radial_b += side * (sine * green - ahead_m * ends_b) / rho_m
                radial_c += side * (cosine * green - ahead_m * ends_c) / rho_m
            axial_a += k_rad_m**2 * _potential(along_m, rho_m, half_m, k_rad_m)
            turn = complex(0.0, scale)
            fields[i, j, 0] = turn * (tilt * axial_a + lean * radial_a)
            fields[i, j, 1] = turn * (tilt * axial_b + lean * radial_b)
            fields[i, j, 2] = turn * (tilt * axial_c + lean * radial_c)


@njit(cache=True, nogil=True, error_model="numpy")
def _potential(along_m: float, rho_m: float, half_m: float, k_rad_m: float) -> complex:
    """Return the integral of G over a segment: 1/R in closed form, G - 1/R by Gauss quadrature."""
    static = math.asinh((half_m - along_m) / rho_m) + math.asinh((half_m + along_m) / rho_m)
    far = along_m * along_m + rho_m * rho_m > FAR_HALVES**2 * half_m * half_m
    real = imag = 0.0
    for q in range(len(_FEW_X) if far else len(_GAUSS_X)):
        x, weight = (_FEW_X[q], _FEW_WEIGHTS[q]) if far else (_GAUSS_X[q], _GAUSS_WEIGHTS[q])
        distance_m = math.sqrt(rho_m * rho_m + (along_m - x * half_m) ** 2)
        sine, cosine = math.sin(0.5 * k_rad_m * distance_m), math.cos(0.5 * k_rad_m * distance_m)
        real -= weight * 2.0 * sine * sine / distance_m
        imag -= weight * 2.0 * sine * cosine / distance_m
    return complex(half_m * real + static, half_m * imag)

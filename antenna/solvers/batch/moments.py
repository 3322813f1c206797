"""Thin wires by the method of moments, as NEC2 has them: what drives the currents of one element.

On a segment of centre c and axis u the current is A + B sin(k s) + C cos(k s), with s along u from c. It and
its slope are continuous from segment to segment; where several wires meet, currents add up to nothing and the
charges on their ends stand as Wu and King have them. The field is matched at the segments' centres, one wire
radius off the axis (Burke and Poggio, NEC Part I: Program Description - Theory, 1981, II and III).
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import j0, j1

from antenna.model.geometry import Array, Complex

ETA_OHM = 376.730313668
"""Impedance of free space."""
SEGMENT_MATCH = 1e-3
"""Ends nearer than this part of a segment are joined (NEC-2 User's Guide, structure geometry)."""
_GAUSS_X, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(16)
_FEW_X, _FEW_WEIGHTS = np.polynomial.legendre.leggauss(2)
FAR_HALVES = 8.0
"""Half-lengths of a segment from where G less 1/R hardly bends any more, and few points are enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight pieces of wire, in the frame of their element."""

    centres_m: Array
    """(N, 3)"""
    axes: Array
    """(N, 3) unit vectors; currents are positive along them."""
    lengths_m: Array
    """(N,)"""
    radii_m: Array
    """(N,)"""

    def ends_m(self, side: int) -> Array:
        """(N, 3) the ends towards the axes (+1), or the other ones (-1)."""
        return np.asarray(self.centres_m + 0.5 * side * self.lengths_m[:, None] * self.axes)


def admittance(segments: Segments, k_rad_m: float) -> tuple[Complex, Array]:
    """What an incident field does: currents at the centres, and on the segments for these.

    The first (N, N) takes the incident field (V/m) along the axes at the centres to the currents (A) there;
    the second (3, N, N) takes those to A, B and C of every segment. A source of V volts on a segment of
    length d is a field of V / d on it.
    """
    spread = _expansion(segments, k_rad_m)
    fields = fields_of_expansion(segments, segments, k_rad_m)
    impedance = np.einsum("ijc,cjn->in", fields, spread, optimize=True)
    return -np.linalg.inv(impedance), spread


def _expansion(segments: Segments, k_rad_m: float) -> Array:
    """(3, N, N) A, B and C of the segments for each current of 1 A at one centre and none at the others."""
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
    """Segments' ends (segment, side) by the place where they meet; every end is in one of the lists."""
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
    """(N, M, 3) field along the axis at centre i of A, B and C of the other segment j, each of 1 A.

    With I'' = -k^2 I but for A, and G = exp(-jkR)/R, R^2 = rho^2 + a^2 + (z - z')^2, integration by parts
    leaves the segment's ends alone:  E_z = -j eta/(4 pi k) { [I dG/dz' - I' G] + k^2 A int G dz' }, E_rho =
    -j eta/(4 pi k rho) [(z' - z) (I dG/dz' - I' G) + I G]  for sine and cosine, and E_rho = j eta/(4 pi k)
    [dG/drho]  for A.
    """
    fields: Complex = np.empty((len(seen.radii_m), len(driving.radii_m), 3), complex)
    write_fields(
        seen.centres_m, seen.axes, seen.radii_m, driving.centres_m, driving.axes, driving.lengths_m, k_rad_m,
        fields,
    )  # fmt: skip
    return fields


@njit(cache=True, nogil=True, error_model="numpy")
def turn(rotation: Array, offset_m: Array, vectors: Array, turned: Array) -> None:
    """Write vectors (M, 3), turned and then moved, into ``turned``."""
    for m in range(len(vectors)):
        for x in range(3):
            turned[m, x] = (
                rotation[x, 0] * vectors[m, 0]
                + rotation[x, 1] * vectors[m, 1]
                + rotation[x, 2] * vectors[m, 2]
            ) + offset_m[x]


@njit(cache=True, nogil=True, error_model="numpy")
def write_fields(
    centres_m: Array,
    axes: Array,
    radii_m: Array,
    driving_centres_m: Array,
    driving_axes: Array,
    driving_lengths_m: Array,
    k_rad_m: float,
    fields: Complex,
) -> None:
    """Write `fields_of_expansion` (N, M, 3); the radii are those of the wires on which the field is matched.

    As in NEC2, these are the ones that count.
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
    """Integral of G over a segment: 1/R in closed form, what is left of G by Gauss points."""
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

"""Far fields of many point currents on the full grid of directions, in single precision.

A point of moment p at r adds p e^{jk r^.r} to N, and G = k^2 eta |N_perp|^2 / (8 pi P). Four directions share
one sine and one cosine: with psi = k (x cos phi + y sin phi) sin theta and zeta = k z cos theta, (theta,
phi), (pi - theta, phi), (theta, phi + pi) and (pi - theta, phi + pi) have the phases psi + zeta, psi - zeta,
zeta - psi and -psi - zeta. The loop over phi is written so that the compiler can vectorise it: it has no
calls, and the sums have fixed offsets, so that the compiler can prove that they do not overlap.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Single = NDArray[np.float32]
SingleComplex = NDArray[np.complex64]

LANE = 64
"""Number of directions phi processed at a time."""
VECTOR = 8
"""Numbers per vector register; directions are padded to a multiple, to avoid a scalar remainder."""


def _turn_polynomials() -> tuple[tuple[np.float32, ...], tuple[np.float32, ...]]:
    """Return polynomials in x^2 of sin(2 pi x) / x and cos(2 pi x), |x| <= 1/2, to single precision."""
    x = 0.5 * np.cos(np.pi * (np.arange(400) + 0.5) / 800.0)
    fits = [
        np.polynomial.Chebyshev.fit(x * x, values, degree, domain=[0.0, 0.25]).convert(
            kind=np.polynomial.Polynomial, domain=[-1.0, 1.0], window=[-1.0, 1.0]
        )
        for values, degree in ((np.sin(2.0 * np.pi * x) / x, 5), (np.cos(2.0 * np.pi * x), 6))
    ]
    sine, cosine = (tuple(np.float32(c) for c in fit.coef) for fit in fits)
    return sine, cosine


(_S0, _S1, _S2, _S3, _S4, _S5), (_C0, _C1, _C2, _C3, _C4, _C5, _C6) = _turn_polynomials()
_HALF = np.float32(0.5)


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy", nogil=True)
def radiate(
    places: Single, axes: Single, moments: SingleComplex, cos_theta: Single, sin_theta: Single,
    cos_phi: Single, sin_phi: Single, power_theta: Single, power_phi: Single,
) -> None:  # fmt: skip
    """Write |N_theta|^2 and |N_phi|^2 on a grid (T, 2H) of one array of n points.

    Places (n, 3) are in wavelengths; the angles are those of the grid's first quarter, theta up to pi/2 and
    phi below pi, (M,) and (H,), the latter padded to a multiple of `VECTOR` with any values.
    """
    sums = np.zeros(16 * LANE, np.float32)
    rows, half_turn = len(power_theta), power_theta.shape[1] // 2
    for t in range(len(cos_theta)):
        ct, st = cos_theta[t], sin_theta[t]
        for first in range(0, half_turn, LANE):
            count = min(LANE, half_turn - first)
            full = min(LANE, len(cos_phi) - first)
            sums[:] = np.float32(0.0)
            for e in range(len(places)):
                x, y, z = places[e, 0] * st, places[e, 1] * st, places[e, 2] * ct
                z -= np.floor(z + _HALF)
                w = z * z
                zs = z * (_S0 + w * (_S1 + w * (_S2 + w * (_S3 + w * (_S4 + w * _S5)))))
                zc = _C0 + w * (_C1 + w * (_C2 + w * (_C3 + w * (_C4 + w * (_C5 + w * _C6)))))
                ux, uy = axes[e, 0], axes[e, 1]
                down = axes[e, 2] * st
                mr, mi = moments[e].real, moments[e].imag
                # the moment and the phase along z
                ar, ai = mr * zc - mi * zs, mr * zs + mi * zc  # times e^(+j zeta)
                br, bi = mr * zc + mi * zs, mi * zc - mr * zs  # times e^(-j zeta)
                for h in range(full):
                    cp, sp = cos_phi[first + h], sin_phi[first + h]
                    p = x * cp + y * sp
                    p -= np.floor(p + _HALF)
                    w = p * p
                    ps = p * (_S0 + w * (_S1 + w * (_S2 + w * (_S3 + w * (_S4 + w * _S5)))))
                    pc = _C0 + w * (_C1 + w * (_C2 + w * (_C3 + w * (_C4 + w * (_C5 + w * _C6)))))
                    across = ct * (ux * cp + uy * sp)
                    along = uy * cp - ux * sp
                    near, far = across - down, -across - down
                    # (theta, phi): e^(j psi) e^(j zeta)
                    fr, fi = ar * pc - ai * ps, ar * ps + ai * pc
                    sums[h] += near * fr
                    sums[64 + h] += near * fi
                    sums[128 + h] += along * fr
                    sums[192 + h] += along * fi
                    # (pi - theta, phi): e^(j psi) e^(-j zeta)
                    fr, fi = br * pc - bi * ps, br * ps + bi * pc
                    sums[256 + h] += far * fr
                    sums[320 + h] += far * fi
                    sums[384 + h] += along * fr
                    sums[448 + h] += along * fi
                    # (theta, phi + pi): e^(-j psi) e^(j zeta)
                    fr, fi = ar * pc + ai * ps, ai * pc - ar * ps
                    sums[512 + h] += far * fr
                    sums[576 + h] += far * fi
                    sums[640 + h] += along * fr
                    sums[704 + h] += along * fi
                    # (pi - theta, phi + pi): e^(-j psi) e^(-j zeta)
                    fr, fi = br * pc + bi * ps, bi * pc - br * ps
                    sums[768 + h] += near * fr
                    sums[832 + h] += near * fi
                    sums[896 + h] += along * fr
                    sums[960 + h] += along * fi
            for h in range(count):
                at, back, low = first + h, first + h + half_turn, rows - 1 - t
                power_theta[t, at] = sums[h] ** 2 + sums[64 + h] ** 2
                power_phi[t, at] = sums[128 + h] ** 2 + sums[192 + h] ** 2
                power_theta[low, at] = sums[256 + h] ** 2 + sums[320 + h] ** 2
                power_phi[low, at] = sums[384 + h] ** 2 + sums[448 + h] ** 2
                power_theta[t, back] = sums[512 + h] ** 2 + sums[576 + h] ** 2
                power_phi[t, back] = sums[640 + h] ** 2 + sums[704 + h] ** 2
                power_theta[low, back] = sums[768 + h] ** 2 + sums[832 + h] ** 2
                power_phi[low, back] = sums[896 + h] ** 2 + sums[960 + h] ** 2

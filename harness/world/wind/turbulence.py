"""Continuous random turbulence: white noise shaped to Dryden's or von Karman's spectrum.

Source: MIL-F-8785C (1980), 3.7. One-sided spectra over the spatial frequency W
(rad/m), whose integrals from 0 are the variances:

    Dryden      u    s^2 (2 L / pi) / (1 + (L W)^2)
                v, w s^2 (L / pi) (1 + 3 (L W)^2) / (1 + (L W)^2)^2
    von Karman  u    s^2 (2 L / pi) / (1 + (a L W)^2)^(5/6),                                  a = 1.339
                v, w s^2 (L / pi) (1 + 8/3 (a L W)^2) / (1 + (a L W)^2)^(11/6)

u is along the mean wind, v across it, w vertical. MIL-HDBK-1797 halves the lengths of v and w and doubles
them in the formulas, which is the same. A vehicle that is passed at speed V meets W at the angular frequency
V W, so that white noise through H(p), p = s L / V, has these spectra: Dryden's exactly, von Karman's, which
no filter of finite order has, within 3.3 % (u) and 4.5 % (v, w) up to L W = 10, from where the filter falls
faster: 0.97 (u) and 0.96 (v, w) of the variance are in it. Its coefficients are those in general
use, as in MathWorks' Aerospace Blockset.

Left out: turbulent rotation rates, which matter to vehicles not small against L.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

from foundation.types import Array
from harness.world.gauss_markov import STEPS_AHEAD

Spectrum = Literal["dryden", "von_karman"]
FOOT_M = 0.3048
ORDER = 3
"""Of the highest filter; the others are filled up with states that stay 0."""

_Filter = tuple[tuple[float, ...], tuple[float, ...]]
_FILTERS: dict[Spectrum, tuple[_Filter, _Filter]] = {
    "dryden": (((1.0,), (1.0, 1.0)), ((1.0, math.sqrt(3.0)), (1.0, 2.0, 1.0))),
    "von_karman": (
        ((1.0, 0.25), (1.0, 1.357, 0.1987)),
        ((1.0, 2.7478, 0.3398), (1.0, 2.9958, 1.9754, 0.1539)),
    ),
}
"""Numerator and denominator of H, powers of p rising: along the wind, and across it and vertical."""
_SHAPE_VARIANCE = (2.0 / math.pi, 1.0 / math.pi)
"""Spectrum at W = 0 over s^2 L, of the same two."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LONGEST_PIECE = 0.25
"""In units of L / V: over it the fastest pole, at 11 V / L, decays by 2.8, which 16 nodes integrate to
rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurbulenceScales:
    """Strength and size of the eddies along, across and vertical."""

    std_m_s: tuple[float, float, float]
    length_m: tuple[float, float, float]


def low_altitude_scales(wind_20ft_m_s: float, height_m: float) -> TurbulenceScales:
    """Give what holds at a height between 10 and 1000 feet, by the mean wind 20 feet above the ground.

    MIL-F-8785C, 3.7.3: the vertical strength is a tenth of that wind.
    """
    growth = 0.177 + 0.000823 * height_m / FOOT_M
    vertical_std_m_s = 0.1 * wind_20ft_m_s
    horizontal_std_m_s = vertical_std_m_s / growth**0.4
    horizontal_length_m = height_m / growth**1.2
    return TurbulenceScales(
        std_m_s=(horizontal_std_m_s, horizontal_std_m_s, vertical_std_m_s),
        length_m=(horizontal_length_m, horizontal_length_m, height_m),
    )


class Turbulence:
    """Series of independent turbulence, each stationary from its start; (series, 3) along, across and down.

    ``passing_speed_m_s`` is the V above. The discretisation is exact: the filter's states have the covariance
    of the continuous ones at every instant, whatever the intervals.
    """

    def __init__(
        self,
        spectrum: Spectrum,
        scales: TurbulenceScales,
        *,
        passing_speed_m_s: float,
        series: int,
        rng: np.random.Generator,
    ) -> None:
        along, other = _FILTERS[spectrum]
        self._filters = tuple(
            _StateSpace(
                *numerator_denominator, gain=std_m_s * math.sqrt(shape), time_s=length_m / passing_speed_m_s
            )
            for numerator_denominator, shape, std_m_s, length_m in zip(
                (along, other, other),
                (_SHAPE_VARIANCE[0], _SHAPE_VARIANCE[1], _SHAPE_VARIANCE[1]),
                scales.std_m_s,
                scales.length_m,
                strict=True,
            )
        )
        self._rng = rng
        start = np.array([each.start for each in self._filters])
        self._output = np.array([each.output for each in self._filters])
        self._state = np.einsum("aij,saj->sai", start, rng.standard_normal((series, 3, ORDER)))
        self._dt_s = math.nan
        self._kept = self._drive = np.empty((0, 0, 0))
        self._fresh = self._states = np.empty((0, series, 3, ORDER))
        self._velocities_m_s = np.empty((0, series, 3))
        self._taken = 0

    def step(self, dt_s: float) -> Array:
        """Velocities (series, 3), ``dt_s`` seconds after the last call; not to be written to.

        Worked out for many steps ahead, as `harness.world.wind.force.GustyWind` does.
        """
        if dt_s != self._dt_s or self._taken == len(self._velocities_m_s):
            self._look_ahead(dt_s)
        velocity_m_s: Array = self._velocities_m_s[self._taken]
        self._taken += 1
        return velocity_m_s

    def _look_ahead(self, dt_s: float) -> None:
        if self._taken:
            self._state = self._states[self._taken - 1]
        left = self._fresh[self._taken :]
        self._fresh = left if len(left) else self._rng.standard_normal((STEPS_AHEAD, *self._state.shape))
        if dt_s != self._dt_s:
            self._kept, self._drive = (
                np.array(each) for each in zip(*[f.over(dt_s) for f in self._filters], strict=True)
            )
        self._states = turbulence_path(self._state, self._kept, self._drive, self._fresh)
        self._velocities_m_s = (self._states * self._output).sum(axis=-1)
        self._dt_s, self._taken = dt_s, 0


@njit(cache=True)
def turbulence_path(start: Array, kept: Array, drive: Array, fresh: Array) -> Array:
    """States (steps, series, 3, ORDER) of ``x[k] = kept x[k-1] + drive fresh[k]`` after ``start``.

    For each axis: ``kept`` and ``drive`` are (3, ORDER, ORDER); ``fresh`` are normal draws of unit variance.
    """
    path = np.empty_like(fresh)
    before = start
    for step in range(fresh.shape[0]):
        for series in range(fresh.shape[1]):
            for axis in range(3):
                for i in range(ORDER):
                    value = 0.0
                    for j in range(ORDER):
                        value += kept[axis, i, j] * before[series, axis, j]
                        value += drive[axis, i, j] * fresh[step, series, axis, j]
                    path[step, series, axis, i] = value
        before = path[step]
    return path


class _StateSpace:
    """One filter H(s T) in controllable form, its time in units of T, driven by white noise.

    Unit one-sided spectral density per rad/s is an intensity of pi; ``gain`` has the spectrum's own scale, of
    which T cancels out.
    """

    def __init__(
        self, numerator: tuple[float, ...], denominator: tuple[float, ...], *, gain: float, time_s: float
    ) -> None:
        order = len(denominator) - 1
        self._time_s = time_s
        self._dynamics = np.diag(np.ones(order - 1), 1)
        self._dynamics[-1] = -np.array(denominator[:-1]) / denominator[-1]
        self._input = np.zeros((order, 1))
        self._input[-1] = math.sqrt(math.pi) / denominator[-1]
        self.output = np.zeros(ORDER)
        """(ORDER,) what of the states is velocity, m/s"""
        self.output[: len(numerator)] = gain * np.array(numerator)
        from scipy.linalg import solve_continuous_lyapunov  # noqa: PLC0415  takes 0.2 s, and few have turbulence

        stationary = solve_continuous_lyapunov(self._dynamics, -self._input @ self._input.T)
        self.start = _padded(np.linalg.cholesky(stationary))
        """(ORDER, ORDER) factor of the states' stationary covariance"""

    def over(self, dt_s: float) -> tuple[Array, Array]:
        """What an interval keeps of the states, and a factor of the covariance that it adds.

        The latter, the integral of e^As B B' e^A's, is factored as the quadrature's sum that it is: formed
        first, its small parts, in the fifth power of the interval, would drown in rounding.
        """
        from scipy.linalg import expm  # noqa: PLC0415  as above

        span = dt_s / self._time_s
        pieces = math.ceil(span / _LONGEST_PIECE)
        edges = span * np.arange(pieces) / pieces
        nodes = (edges[:, None] + 0.5 * span / pieces * (1.0 + _NODES)).ravel()
        weights = np.tile(0.5 * span / pieces * _WEIGHTS, pieces)
        responses = (expm(nodes[:, None, None] * self._dynamics) @ self._input)[..., 0]
        upper = np.linalg.qr(np.sqrt(weights)[:, None] * responses).R
        signs = np.where(np.diag(upper) < 0.0, -1.0, 1.0)  # whatever the library prefers
        return _padded(expm(span * self._dynamics)), _padded((signs[:, None] * upper).T)


def _padded(matrix: Array) -> Array:
    padded = np.zeros((ORDER, ORDER))
    padded[: len(matrix), : len(matrix)] = matrix
    return padded

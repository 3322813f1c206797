"""Continuous random turbulence: white noise shaped to Dryden's or von Karman's spectrum.

Source: MIL-F-8785C (1980), 3.7. One-sided spectra over the spatial frequency W
(rad/m), whose integrals from 0 are the variances:

    Dryden      u    s^2 (2 L / pi) / (1 + (L W)^2)
                v, w s^2 (L / pi) (1 + 3 (L W)^2) / (1 + (L W)^2)^2
    von Karman  u    s^2 (2 L / pi) / (1 + (a L W)^2)^(5/6),                                  a = 1.339
                v, w s^2 (L / pi) (1 + 8/3 (a L W)^2) / (1 + (a L W)^2)^(11/6)

u is along the mean wind, v across it, w vertical. MIL-HDBK-1797 halves the lengths of v and w and doubles
them in the formulas, which is equivalent. If the pattern passes a vehicle at speed V, W has the angular
frequency V W, so white noise filtered by H(p), p = s L / V, has these spectra: Dryden's exactly; von
Karman's, which has no filter of finite order, within 3.3 % (u) and 4.5 % (v, w) up to L W = 10. Above that
the filter falls faster; it contains 0.97 (u) and 0.96 (v, w) of the variance. Its coefficients are the usual
ones, as in MathWorks' Aerospace Blockset.

Not modelled: turbulent rotation rates, which affect vehicles that are not small compared with L.
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
"""Order of the highest filter; the others are padded with states that stay 0."""

_Filter = tuple[tuple[float, ...], tuple[float, ...]]
_FILTERS: dict[Spectrum, tuple[_Filter, _Filter]] = {
    "dryden": (((1.0,), (1.0, 1.0)), ((1.0, math.sqrt(3.0)), (1.0, 2.0, 1.0))),
    "von_karman": (
        ((1.0, 0.25), (1.0, 1.357, 0.1987)),
        ((1.0, 2.7478, 0.3398), (1.0, 2.9958, 1.9754, 0.1539)),
    ),
}
"""Numerator and denominator of H in ascending powers of p: along the wind, and across it and vertical."""
_SHAPE_VARIANCE = (2.0 / math.pi, 1.0 / math.pi)
"""Spectrum at W = 0 over s^2 L, for the same two."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LONGEST_PIECE = 0.25
"""In units of L / V. The fastest pole, at 11 V / L, decays by exp(-2.8) in it, which 16 nodes integrate to
rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurbulenceScales:
    """Standard deviations and scale lengths along, across and vertical."""

    std_m_s: tuple[float, float, float]
    length_m: tuple[float, float, float]


def low_altitude_scales(wind_20ft_m_s: float, height_m: float) -> TurbulenceScales:
    """Return the scales at a height between 10 and 1000 feet, for the mean wind 20 feet above the ground.

    MIL-F-8785C, 3.7.3: the vertical standard deviation is a tenth of that wind.
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
    """Independent series of turbulence, stationary from the start; (series, 3) along, across and down.

    ``passing_speed_m_s`` is V above. The discretisation is exact: the filter's states have the covariance of
    the continuous ones at every instant, for any intervals.
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
        """Return velocities (series, 3), ``dt_s`` seconds after the last call; do not write to them.

        Computed for many steps ahead, as in `harness.world.wind.force.GustyWind`.
        """
        if dt_s != self._dt_s or self._taken == len(self._velocities_m_s):
            self._look_ahead(dt_s)
        velocity_m_s: Array = self._velocities_m_s[self._taken]
        self._taken += 1
        return velocity_m_s

    def discard_drawn(self) -> None:
        """Discard what was drawn in advance: the next values come from the generator's present state."""
        if self._taken:
            self._state = self._states[self._taken - 1]
        self._fresh, self._velocities_m_s, self._taken = self._fresh[:0], self._velocities_m_s[:0], 0

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
    """Return states (steps, series, 3, ORDER) of ``x[k] = kept x[k-1] + drive fresh[k]`` after ``start``.

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
    """One filter H(s T) in controllable form, with time in units of T, driven by white noise.

    A one-sided spectral density of 1 per rad/s is an intensity of pi; ``gain`` is the spectrum's scale, from
    which T cancels.
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
        """(ORDER,) output vector from the states to the velocity, m/s"""
        self.output[: len(numerator)] = gain * np.array(numerator)
        from scipy.linalg import solve_continuous_lyapunov  # noqa: PLC0415  takes 0.2 s, only for turbulence

        stationary = solve_continuous_lyapunov(self._dynamics, -self._input @ self._input.T)
        self.start = _padded(np.linalg.cholesky(stationary))
        """(ORDER, ORDER) factor of the states' stationary covariance"""

    def over(self, dt_s: float) -> tuple[Array, Array]:
        """Return the transition matrix of an interval, and a factor of the covariance that it adds.

        The covariance, the integral of e^As B B' e^A's, is factored directly from the terms of the
        quadrature: in its sum the small parts, of fifth order in the interval, would be lost in rounding.
        """
        from scipy.linalg import expm  # noqa: PLC0415  as above

        span = dt_s / self._time_s
        pieces = math.ceil(span / _LONGEST_PIECE)
        edges = span * np.arange(pieces) / pieces
        nodes = (edges[:, None] + 0.5 * span / pieces * (1.0 + _NODES)).ravel()
        weights = np.tile(0.5 * span / pieces * _WEIGHTS, pieces)
        responses = (expm(nodes[:, None, None] * self._dynamics) @ self._input)[..., 0]
        upper = np.linalg.qr(np.sqrt(weights)[:, None] * responses).R
        signs = np.where(np.diag(upper) < 0.0, -1.0, 1.0)  # independent of the library's convention
        return _padded(expm(span * self._dynamics)), _padded((signs[:, None] * upper).T)


def _padded(matrix: Array) -> Array:
    padded = np.zeros((ORDER, ORDER))
    padded[: len(matrix), : len(matrix)] = matrix
    return padded

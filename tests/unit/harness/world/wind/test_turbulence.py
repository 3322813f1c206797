"""Turbulence compared with MIL-F-8785C: variance, correlation, density, independence of the step. 5 s."""

import math

import numpy as np
import pytest
from scipy.signal import welch

from harness.world.wind import Wind, WindConfig
from harness.world.wind.turbulence import Turbulence, TurbulenceScales, low_altitude_scales

SCALES = TurbulenceScales(std_m_s=(2.0, 1.5, 1.0), length_m=(20.0, 12.0, 10.0))
SPEED_M_S = 5.0
SERIES = 200
VARIANCE = {"dryden": (1.0, 1.0, 1.0), "von_karman": (0.9687, 0.9623, 0.9623)}
"""Variance of the filters over the square of the standard deviation.

Dryden's integrate to 1. The rational filters for von Karman's lack what they fall off too early: |H|^2
integrated over all frequencies, by the continuous Lyapunov equation, is 0.9687 and 0.9623.
"""


def turbulence(spectrum, *, series=SERIES, seed=1):
    return Turbulence(
        spectrum, SCALES, passing_speed_m_s=SPEED_M_S, series=series, rng=np.random.default_rng(seed)
    )


def record(spectrum, *, seconds, dt_s, **options):
    """Return velocities (T, series, 3)."""
    source = turbulence(spectrum, **options)
    return np.array([source.step(dt_s) for _ in range(round(seconds / dt_s))])


def analytic(spectrum, axis, omega_rad_s):
    """Return the one-sided density over the angular frequency, (m/s)^2 per rad/s, of MIL-F-8785C."""
    length_m, variance = SCALES.length_m[axis], SCALES.std_m_s[axis] ** 2
    x = length_m * omega_rad_s / SPEED_M_S
    if spectrum == "von_karman":
        x = 1.339 * x
        shape = (
            2.0 / (1.0 + x**2) ** (5 / 6) if axis == 0 else (1.0 + 8 / 3 * x**2) / (1.0 + x**2) ** (11 / 6)
        )
    else:
        shape = 2.0 / (1.0 + x**2) if axis == 0 else (1.0 + 3.0 * x**2) / (1.0 + x**2) ** 2
    return variance * length_m / (math.pi * SPEED_M_S) * shape


@pytest.mark.parametrize("spectrum", ["dryden", "von_karman"])
def test_the_variance_is_the_spectrums_integral_from_the_start_on(spectrum):
    """20000 independent series: a variance has a relative error of sqrt(2/20000) = 1 %; four of those."""
    source = turbulence(spectrum, series=20_000)
    for steps in (1, 1, 200):
        for _ in range(steps):
            now = source.step(0.02)
        ratio = now.var(axis=0) / np.square(SCALES.std_m_s)
        np.testing.assert_allclose(ratio, VARIANCE[spectrum], rtol=0.04)


def test_the_spectra_integrate_to_the_variance():
    """The integral of each density over 0..inf is s^2, which checks the constants of both formulas."""
    omega = np.concatenate([[0.0], np.logspace(-6, 8, 200_000)])
    for spectrum in ("dryden", "von_karman"):
        for axis in range(3):
            density = analytic(spectrum, axis, omega)
            total = np.sum(0.5 * (density[1:] + density[:-1]) * np.diff(omega))
            # the constant 1.339 is rounded, and the grid ends at 1e8 rad/s
            assert total == pytest.approx(SCALES.std_m_s[axis] ** 2, rel=2e-3)


@pytest.mark.parametrize("spectrum", ["dryden", "von_karman"])
def test_the_density_is_the_analytic_one(spectrum):
    """Welch's method on 200 series of 205 s in half-overlapping Hann windows of 41 s.

    That averages 200 x 9 periodograms, of which every second is independent: 3 % of scatter per bin, 1 % in
    bands of ten. Von Karman's filters are within 4.5 % themselves below L W = 10, which is 0.4 to 0.8 Hz here
    and far from the sampling's 25 Hz. Above 0.05 Hz, two bins, the window's leakage is small.
    """
    dt_s = 0.02
    series = record(spectrum, seconds=205.0, dt_s=dt_s)
    frequency_hz, density = welch(series, fs=1.0 / dt_s, nperseg=2048, axis=0, detrend=False)
    density = density.mean(axis=1) / (2.0 * math.pi)  # per rad/s
    omega = 2.0 * math.pi * frequency_hz
    for axis in range(3):
        expected = analytic(spectrum, axis, omega)
        inside = np.flatnonzero((frequency_hz > 0.05) & (SCALES.length_m[axis] * omega / SPEED_M_S < 10.0))
        assert len(inside) > 10
        for band in np.array_split(inside, max(1, len(inside) // 10)):
            assert density[band, axis].mean() == pytest.approx(expected[band].mean(), rel=0.07)


@pytest.mark.parametrize(
    ("spectrum", "axis", "largest"),
    [
        *(("dryden", axis, 0.0) for axis in range(3)),
        *zip(["von_karman"] * 3, range(3), (0.033, 0.0451, 0.0451), strict=True),
    ],
)
def test_the_filters_response_is_the_spectrum_within_the_stated_error(spectrum, axis, largest):
    """|c (j W L - A)^-1 b|^2 L / (pi V) over the analytic density, from L W = 0 to 10.

    b has the square root of the intensity, pi, that makes a one-sided density of 1 per rad/s.
    """
    source = turbulence(spectrum, series=1)._filters[axis]
    order = len(source._dynamics)
    normalised = np.linspace(0.0, 10.0, 2001)
    time_s = SCALES.length_m[axis] / SPEED_M_S
    systems = 1j * normalised[:, None, None] * np.eye(order) - source._dynamics
    response = np.linalg.solve(systems, np.broadcast_to(source._input, (2001, order, 1)))[..., 0]
    density = np.abs(response @ source.output[:order]) ** 2 * time_s / math.pi
    apart = np.abs(density / analytic(spectrum, axis, normalised / time_s) - 1.0)
    assert apart.max() == pytest.approx(largest, abs=1e-12 if largest == 0.0 else 2e-4)


def test_drydens_correlation_is_exponential_along_the_wind_and_has_a_negative_tail_across_it():
    """Transforms of the spectra: exp(-r) along, (1 - r/2) exp(-r) across, r = V lag / L."""
    dt_s = 0.1
    series = record("dryden", seconds=100.0, dt_s=dt_s, series=400)
    for lag in (1, 5, 20, 60):
        measured = np.mean(series[lag:] * series[:-lag], axis=(0, 1)) / np.square(SCALES.std_m_s)
        r = SPEED_M_S * lag * dt_s / np.array(SCALES.length_m)
        expected = np.exp(-r) * np.array([1.0, 1.0 - r[1] / 2.0, 1.0 - r[2] / 2.0])
        # 400 series of 100 s over correlation times of 2 L/V <= 8 s: >= 5000 samples, 1.4 %; four of those
        np.testing.assert_allclose(measured, expected, atol=0.06)


@pytest.mark.parametrize("spectrum", ["dryden", "von_karman"])
def test_two_steps_equal_one_of_their_sum(spectrum):
    """Transition and added covariance of two steps of 0.3 s equal those of 0.6 s, except for rounding."""
    for each in turbulence(spectrum)._filters:
        kept, drive = each.over(0.3)
        kept_sum, drive_sum = each.over(0.6)
        np.testing.assert_allclose(kept @ kept, kept_sum, atol=1e-12)
        added = kept @ drive @ drive.T @ kept.T + drive @ drive.T
        np.testing.assert_allclose(added, drive_sum @ drive_sum.T, atol=1e-12)
        # and the stationary covariance is invariant
        stationary = each.start @ each.start.T
        np.testing.assert_allclose(kept @ stationary @ kept.T + drive @ drive.T, stationary, atol=1e-12)


def test_intervals_may_change_and_draws_are_used_in_their_order():
    """A source with mixed intervals equals the explicit recursion with the same random stream."""
    source, rng = turbulence("von_karman", series=2, seed=9), np.random.default_rng(9)
    unit = rng.standard_normal((2, 3, 3))
    state = np.stack([unit[:, a] @ source._filters[a].start.T for a in range(3)], axis=1)
    over = {dt_s: [each.over(dt_s) for each in source._filters] for dt_s in (0.004, 0.1)}
    for dt_s in [0.004] * 70 + [0.1] * 3 + [0.004] * 60:
        fresh = rng.standard_normal((2, 3, 3))
        now = source.step(dt_s)
        for axis, each in enumerate(source._filters):
            kept, drive = over[dt_s][axis]
            state[:, axis] = state[:, axis] @ kept.T + fresh[:, axis] @ drive.T
            np.testing.assert_allclose(now[:, axis], state[:, axis] @ each.output, atol=1e-12)


def test_low_altitude_scales_are_those_of_the_specification():
    """At 20 feet of height in 10 m/s: 0.177 + 0.000823 x 20 = 0.19346, to -0.4 is 1.929, to -1.2 is 7.178."""
    scales = low_altitude_scales(10.0, 20.0 * 0.3048)
    np.testing.assert_allclose(scales.std_m_s, (1.929, 1.929, 1.0), rtol=1e-3)
    np.testing.assert_allclose(scales.length_m, (7.178 * 6.096, 7.178 * 6.096, 6.096), rtol=1e-3)
    # at 1000 feet all are equal: the values match the model of higher altitudes
    top = low_altitude_scales(10.0, 304.8)
    np.testing.assert_allclose(top.std_m_s, 1.0, rtol=1e-6)
    np.testing.assert_allclose(top.length_m, 304.8, rtol=1e-6)


VELOCITY = WindConfig(kind="velocity", mean_m_s=8.0, direction_deg=30.0, turbulence="dryden", correlation=0.8)


def velocities(config, *, vehicles, steps, dt_s, seed=1):
    wind = Wind(config, vehicles, np.random.default_rng(seed), formation_height_m=10.0)
    height_m = np.full(vehicles, 10.0)
    return np.array([wind.step(dt_s, time_us=0, height_m=height_m).air_vel_ned_m_s for _ in range(steps)])


def test_the_winds_turbulence_has_the_mean_the_axes_and_the_correlation_of_its_table():
    """W20 is the uniform mean, 8 m/s: 0.8 m/s vertical, 0.8 x (0.177 + 0.000823 x 32.8)^-0.4 = 1.51 across.

    4000 s over 2 L/V of at most 17 s (L_u = 68 m): 240 independent samples, or 4.6 % of a spread.
    """
    samples = velocities(VELOCITY, vehicles=2, steps=20_000, dt_s=0.2)
    towards = np.array((math.cos(math.radians(30.0)), math.sin(math.radians(30.0)), 0.0))
    np.testing.assert_allclose(samples.mean(axis=(0, 1)), 8.0 * towards, atol=4.0 * 1.51 / math.sqrt(240.0))
    rest = samples - 8.0 * towards
    np.testing.assert_allclose(rest.std(axis=0), np.tile((1.51, 1.51, 0.8), (2, 1)), rtol=4.0 * 0.046)
    for axis in range(3):
        correlation = np.corrcoef(rest[:, 0, axis], rest[:, 1, axis])[0, 1]
        assert correlation == pytest.approx(0.8, abs=4.0 * (1.0 - 0.8**2) / math.sqrt(240.0))


def test_correlation_is_longest_along_the_wind_for_any_direction():
    """Over 1 s the correlation along is exp(-8/68) = 0.889, across (1 - 8/136) exp(-8/68) = 0.837."""
    samples = velocities(VELOCITY, vehicles=400, steps=100, dt_s=0.1)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    own = samples - samples.mean(axis=1, keepdims=True)  # without the shared part: 400 independent series
    for axis, expected in ((np.array((c, s, 0.0)), 0.889), (np.array((-s, c, 0.0)), 0.837)):
        part = own @ axis
        assert np.mean(part[10:] * part[:-10]) / np.mean(part**2) == pytest.approx(expected, abs=0.015)


def test_the_seed_determines_the_turbulence_and_equal_seeds_give_equal_bytes():
    first, again, other = (
        velocities(VELOCITY, vehicles=3, steps=120, dt_s=0.004, seed=seed) for seed in (4, 4, 5)
    )
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_calm_air_has_no_turbulence_and_a_least_speed_keeps_the_filters_valid():
    assert not velocities(
        WindConfig(kind="velocity", mean_m_s=0.0, turbulence="von_karman"), vehicles=2, steps=10, dt_s=0.1
    ).any()
    stirred = WindConfig(kind="velocity", mean_m_s=0.0, turbulence="von_karman", wind_20ft_m_s=5.0)
    assert np.isfinite(velocities(stirred, vehicles=2, steps=10, dt_s=0.1)).all()
    assert velocities(stirred, vehicles=2, steps=10, dt_s=0.1).any()

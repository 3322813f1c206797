"""Estimator tests: consistency, whiteness of innovations, GPS outages, compass errors.

The errors of a consistent filter have the covariance that it reports: the normalised estimation error squared
(NEES), e' P^-1 e, of three numbers averages to three, and its innovations are white with the predicted
variance (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
section 5.4). This holds only for data that match the filter's model exactly: white sensor noises of the
assumed size, and biases with the assumed random walk. All results are determined by their seeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2, norm

from autopilot.estimation import atmosphere
from autopilot.estimation.aiding import Aiding
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from foundation.geometry.geodesy import geodetic_to_ned
from foundation.types import Array
from studies.vehicle.sensor_flights import (
    SITE,
    SLOW_STEPS,
    STEP_S,
    STEP_US,
    Noise,
    Path,
    SimulatedFlight,
    errors,
    feed,
    figure_eight,
    replay,
    rest,
    simulate,
)

MATCHED_PARAMS = EstimatorParams(
    gyro_noise_rad_s=0.0138 * np.sqrt(STEP_S / 0.01),
    accel_noise_m_s2=0.1 * np.sqrt(STEP_S / 0.01),
    accel_bias_init_m_s2=0.1,
    gps_vel_noise_m_s=0.1,
    baro_noise_m=0.0873,  # 1 Pa at 488 m: dh = dp / (rho g), rho = 1.168 kg/m^3
    mag_noise_gauss=0.004,
    heading_gate=5.0,
)
"""Parameters that match the simulated sensors exactly.

PX4's heading gate of 2.6 sigma would reject one valid measurement in a hundred, which truncates the noise.
"""
ALIGNED_STEPS = 251
"""Steps of the alignment window, including the first."""
SETTLED_S = 15.0
"""5 s at rest and 10 s of flight, after which the initial errors have decayed."""
EPOCH_S = 0.5
STATES = {"attitude": 0, "velocity": 3, "position": 6, "gyro bias": 9, "accelerometer bias": 12}
"""First error of each group of three."""
MEASUREMENTS = ("velocity", "position", "height", "heading")
LAGS = 20


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """Result of a Monte Carlo campaign of r runs, each evaluated at the same e epochs."""

    time_s: Array
    """(e,) time of the fusion horizon"""
    nees: dict[str, Array]
    """(r, e) by group of states; each has three degrees of freedom"""
    innovations: dict[str, list[Array]]
    """By measurement and run: (n, axes), each divided by its standard deviation"""
    refused: int
    """Rejected measurements of all runs; expected is 0"""

    def band(self) -> tuple[float, float]:
        """Return the two-sided 95 % band of the mean of one epoch's r NEES, per degree of freedom.

        Runs are independent, so the sum of r NEES of 3 degrees of freedom is chi-squared with 3 r.
        """
        freedom = 3 * next(iter(self.nees.values())).shape[0]
        low, high = chi2.ppf((0.025, 0.975), freedom) / freedom
        return float(low), float(high)

    def mean(self, group: str) -> Array:
        """Return the NEES of each epoch, mean over the runs, per degree of freedom, (e,); 1 if consistent."""
        mean: Array = self.nees[group].mean(axis=0) / 3.0
        return mean

    def overall(self, group: str) -> tuple[float, tuple[float, float]]:
        """Return the mean over all runs and epochs, per degree of freedom, and its 95 % band.

        Epochs of a run are correlated. Their effective number is n / (1 + 2 sum rho) (Bartlett), with the
        autocorrelation rho of the series, summed up to the first lag at which it is not positive.
        """
        nees = self.nees[group]
        runs, epochs = nees.shape
        off = nees - 3.0
        power = float(np.mean(off**2))
        inflation = 1.0
        for lag in range(1, epochs):
            rho = float(np.mean(off[:, lag:] * off[:, :-lag])) / power
            if rho <= 0.0:
                break
            inflation += 2.0 * rho
        freedom = 3.0 * runs * epochs / inflation
        low, high = chi2.ppf((0.025, 0.975), freedom) / freedom
        return float(nees.mean()) / 3.0, (float(low), float(high))

    def inside(self, group: str) -> float:
        """Return the share of epochs whose mean is inside the band; 0.95 is expected if consistent."""
        low, high = self.band()
        mean = self.mean(group)
        return float(np.mean((mean > low) & (mean < high)))


def pooled(campaigns: Sequence[Consistency]) -> Consistency:
    """Return one campaign with the runs of several campaigns, which have the same epochs."""
    first = campaigns[0]
    return Consistency(
        time_s=first.time_s,
        nees={group: np.concatenate([one.nees[group] for one in campaigns]) for group in first.nees},
        innovations={
            name: [series for one in campaigns for series in one.innovations[name]]
            for name in first.innovations
        },
        refused=sum(one.refused for one in campaigns),
    )


def matched_noise(rng: np.random.Generator) -> Noise:
    """Draw sensor noises and biases with the statistics in `MATCHED_PARAMS`, bias random walks included."""
    _, _, gyro_walk_psd, accel_walk_psd = MATCHED_PARAMS.process_noise_psd
    return Noise(
        gps_bias_m=0.0, gps_pos_m=1.5, gps_vel_down_ratio=1.5, gyro_bias_rad_s=rng.normal(0.0, 0.005, 3),
        accel_bias_m_s2=rng.normal(0.0, MATCHED_PARAMS.accel_bias_init_m_s2, 3),
        gyro_bias_walk_rad_s=gyro_walk_psd**0.5, accel_bias_walk_m_s2=accel_walk_psd**0.5,
    )  # fmt: skip


def consistency(
    *, runs: int = 20, duration_s: float = 60.0, seed: int = 1, path: Path = figure_eight
) -> Consistency:
    """Fly ``runs`` times with new sensor draws; collect errors, reported covariances and innovations."""
    nees: list[Array] = []
    innovations: dict[str, list[Array]] = {name: [] for name in MEASUREMENTS}
    time_s = np.empty(0)
    refused = 0
    for rng in map(np.random.default_rng, np.random.SeedSequence(seed).spawn(runs)):
        flight = simulate(path, duration_s, rng, matched_noise(rng))
        time_s, of_run, normalised, refused_in_run = _evaluate(flight)
        nees.append(of_run)
        refused += refused_in_run
        for name, series in normalised.items():
            innovations[name].append(series)
    stacked = np.array(nees)
    return Consistency(
        time_s=time_s,
        nees={group: stacked[:, :, i] for i, group in enumerate(STATES)},
        innovations=innovations,
        refused=refused,
    )


def _evaluate(flight: SimulatedFlight) -> tuple[Array, Array, dict[str, Array], int]:
    """Return epochs (e,), NEES (e, groups), normalised innovations and the count of rejections of one run."""
    estimator = Estimator(MATCHED_PARAMS)
    # the height of the frame follows from the first second's pressure, an error unobservable for any filter
    ground_m = atmosphere.altitude_m(flight.pressure_pa[:ALIGNED_STEPS:SLOW_STEPS]).mean() - SITE.altitude_m
    seen: list[tuple[int, Array, Array]] = []
    series: dict[str, list[Array]] = {name: [] for name in MEASUREMENTS}
    last_us = dict.fromkeys(MEASUREMENTS, -1)
    every = round(EPOCH_S / STEP_S)

    def sample(k: int, estimator: Estimator) -> None:
        fusion, delayed = estimator.fusion, estimator.filter
        if k * STEP_S < SETTLED_S or fusion is None or delayed is None:
            return
        for name in MEASUREMENTS:
            aiding: Aiding = getattr(fusion, name)
            if aiding.measured_us is not None and aiding.measured_us > last_us[name]:
                last_us[name] = aiding.measured_us
                series[name].append(aiding.innovation / np.sqrt(aiding.innovation_var))
        if k % every == 0:
            seen.append((delayed.horizon_us, delayed.x.copy(), delayed.cov.copy()))

    feed(estimator, flight, sample)
    state = estimator.state
    origin_m = geodetic_to_ned(
        state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m, origin_lat_deg=SITE.latitude_deg,
        origin_lon_deg=SITE.longitude_deg, origin_alt_m=SITE.altitude_m,
    )  # fmt: skip
    origin_m[2] = -ground_m
    nees = np.array([_nees(flight, horizon_us, x, cov, origin_m) for horizon_us, x, cov in seen])
    refused = sum(getattr(estimator.fusion, name).refused for name in MEASUREMENTS)
    time_s = np.array([horizon_us * 1e-6 for horizon_us, _, _ in seen])
    return time_s, nees, {name: np.array(values) for name, values in series.items()}, refused


def _nees(flight: SimulatedFlight, horizon_us: int, x: Array, cov: Array, origin_m: Array) -> Array:
    """Return the NEES of each group of three states at the fusion horizon, (groups,)."""
    k = horizon_us // STEP_US - 1
    turn = flight.rotations_ned_frd[k] * Rotation.from_quat(x[:4], scalar_first=True).inv()
    error = np.concatenate(
        (
            turn.as_rotvec(),
            flight.vel_ned_m_s[k] - x[4:7],
            flight.pos_ned_m[k] - origin_m - x[7:10],
            flight.gyro_bias_rad_s[k] - x[10:13],
            flight.accel_bias_m_s2[k] - x[13:16],
        )
    )
    groups = [slice(first, first + 3) for first in STATES.values()]
    return np.array([error[g] @ np.linalg.solve(cov[g, g], error[g]) for g in groups])


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Comparison of a measurement's innovations with white noise of the expected variance."""

    inside: float
    """Share of autocorrelations, over all runs, axes and lags, within +-1.96 / sqrt(n): 0.95 if white."""
    tested: int
    """Number of autocorrelations"""
    band: tuple[float, float]
    """95 % band of that share, for independent tests"""
    mean_square: float
    """Of the normalised innovations: 1 if their variance is the one the filter predicted"""
    mean_square_band: tuple[float, float]
    """95 % band of the mean square: chi-squared with one degree of freedom for each innovation"""
    greatest: float
    """Largest over all lags of the autocorrelation averaged over runs and axes"""
    greatest_limit: float
    """Its 95 % limit for all lags together (Bonferroni)"""


def whiteness(runs: list[Array]) -> Whiteness:
    """Test normalised innovations, (n, axes) of each run, at lags 1 to `LAGS`."""
    correlations, limits = [], []
    for series in runs:
        power = np.mean(series**2, axis=0)
        for lag in range(1, LAGS + 1):
            correlations.append(np.mean(series[lag:] * series[:-lag], axis=0) / power)
            limits.append(np.full(series.shape[1], 1.96 / np.sqrt(len(series))))
    values, bounds = np.array(correlations), np.array(limits)
    tested = values.size
    low, high = binom.ppf((0.025, 0.975), tested, 0.95) / tested
    count = sum(series.size for series in runs)
    square_low, square_high = chi2.ppf((0.025, 0.975), count) / count
    by_lag = values.reshape(len(runs), LAGS, -1).mean(axis=(0, 2))
    return Whiteness(
        inside=float(np.mean(np.abs(values) < bounds)), tested=tested, band=(float(low), float(high)),
        mean_square=float(np.mean(np.concatenate([series.ravel() for series in runs]) ** 2)),
        mean_square_band=(float(square_low), float(square_high)), greatest=float(np.abs(by_lag).max()),
        greatest_limit=float(norm.isf(0.025 / LAGS) / np.sqrt(count)),
    )  # fmt: skip


def outage_drift_m(seed: int, *, outage_s: float = 10.0) -> float:
    """Return the horizontal drift of the estimate in a GPS outage after 30 s of calm hover."""
    fixes_until_s = 30.1
    flight = simulate(rest, 30.0 + outage_s, np.random.default_rng(seed))
    known = {k: fix for k, fix in flight.fixes.items() if k * STEP_S < fixes_until_s}
    states = replay(Estimator(EstimatorParams()), replace(flight, fixes=known))
    before, after = states[round(30.0 / STEP_S) - 1], states[-1]
    return float(np.linalg.norm((after.pos_ned_m - before.pos_ned_m)[:2]))


@dataclass(frozen=True, kw_only=True)
class WrongCompass:
    """Result of a flight whose compass has a constant heading error from the start."""

    caught_s: float | None
    """From the start of motion to the reset of the heading; None if it was not reset"""
    heading_error_rad: float
    """rms over the last ten seconds"""
    resets: int
    """Number of heading resets"""


def wrong_compass(seed: int, error_rad: float, *, path: Path = figure_eight) -> WrongCompass:
    """Fly 40 s, in motion from 5 s on, with a compass turned by ``error_rad`` about the body's z axis."""
    onset_s = 5.0
    flight = simulate(path, 40.0, np.random.default_rng(seed))
    turned = Rotation.from_rotvec([0.0, 0.0, error_rad]).apply(flight.field_gauss)
    states = replay(Estimator(EstimatorParams()), replace(flight, field_gauss=turned))
    resets = [state.yaw_reset_counter for state in states]
    caught = next((k for k, count in enumerate(resets) if count), None)
    last = errors(flight, states[:]).attitude_ned_rad[-round(10.0 / STEP_S) :, 2]
    return WrongCompass(
        caught_s=None if caught is None else float((caught + 1) * STEP_S - onset_s),
        heading_error_rad=float(np.sqrt(np.mean(last**2))),
        resets=resets[-1],
    )

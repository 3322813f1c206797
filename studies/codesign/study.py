"""Monte Carlo study of the localisation filter against bound, batch optimum and predicted covariance."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from autopilot.onboard.localisation.kernels import STATES
from studies.codesign.batch import batch_optimum
from studies.codesign.bounds import aligned_error_m, posterior_bound, shape_basis
from studies.codesign.simulated import NO_TROUBLE, Array, SimulatedFlight, Trouble, simulate


@dataclass(frozen=True, slots=True)
class LocalisationResult:
    """Result of one setting; horizontal rms over runs and UAVs after the best rigid alignment."""

    runs: int
    bound_m: float
    """Posterior Cramer-Rao bound."""
    filter_m: float
    batch_m: float | None
    """Error of the batch optimum; None if it was not computed."""
    predicted_m: float
    """Error predicted by the filter's covariance."""
    nees: float
    """Mean over runs of the aligned error squared, normalised by the filter's covariance."""
    nees_band: tuple[float, float]
    """95 % band of `nees` of a consistent filter."""

    @property
    def filter_over_bound(self) -> float:
        """Ratio of the filter's error to the bound."""
        return self.filter_m / self.bound_m

    @property
    def batch_over_bound(self) -> float | None:
        """Ratio of the batch optimum's error to the bound."""
        return None if self.batch_m is None else self.batch_m / self.bound_m


def _squares(flight: SimulatedFlight, *, batch: bool) -> tuple[float, float, float, float, float]:
    """Return mean squares of one run: bound, filter, batch optimum (NaN if not ``batch``), predicted; NEES.

    All use the odometry of the last instant, so that only the estimators are compared.
    """
    count = len(flight.places_ned_m)
    filter_ = flight.filtered()
    truth_m, odometry_m = flight.pos_ned_m[-1, :, :2], flight.odometry_ned_m[-1, :, :2]
    found_m = odometry_m + filter_.state.reshape(count, -1)[:, :2]
    horizontal = (STATES * np.arange(count)[:, np.newaxis] + np.arange(2)).ravel()
    cov = filter_.cov[np.ix_(horizontal, horizontal)]

    at_truth = shape_basis(flight.pos_ned_m[-1])
    bound = at_truth.T @ posterior_bound(flight) @ at_truth
    # The filter's covariance refers to its own estimate, whose heading differs: errors are in its frame.
    at_found = shape_basis(found_m)
    error = at_found.T @ aligned_error_m(truth_m, found_m).ravel()
    predicted = at_found.T @ cov @ at_found
    optimum = np.nan
    if batch:
        optimum = float(
            np.mean(np.square(aligned_error_m(odometry_m + batch_optimum(flight), truth_m))) * 2.0
        )
    return (
        float(np.trace(bound)) / count,
        float(error @ error) / count,
        optimum,
        float(np.trace(predicted)) / count,
        float(error @ np.linalg.solve(predicted, error)),
    )


def localisation_study(
    places_ned_m: Array,
    *,
    runs: int,
    seed: int,
    duration_s: float = 20.0,
    trouble: Trouble = NO_TROUBLE,
    scheduled: bool = False,
    batch: bool = True,
) -> LocalisationResult:
    """Return the result of Monte Carlo runs of the filter of a randomly chosen UAV.

    Args:
        places_ned_m: (N, 3)
        runs: number of independent flights.
        seed: seed of all random numbers.
        duration_s: length of a flight; its final errors count.
        trouble: additional faults; the bound includes its loss but no other fault.
        scheduled: pairs are measured by one end only, otherwise by both.
        batch: compute the batch optimum too.

    """
    squares = []
    for rng in map(np.random.default_rng, np.random.SeedSequence(seed).spawn(runs)):
        flight = simulate(
            places_ned_m=places_ned_m, duration_s=duration_s, rng=rng,
            own=int(rng.integers(len(places_ned_m))), trouble=trouble, scheduled=scheduled,
        )  # fmt: skip
        squares.append(_squares(flight, batch=batch))
    means = np.mean(squares, axis=0)
    bound_m, filter_m, batch_m, predicted_m = np.sqrt(means[:4]).tolist()
    freedom = runs * (2 * len(places_ned_m) - 3)
    low, high = (chi2.ppf((0.025, 0.975), freedom) / runs).tolist()
    return LocalisationResult(
        runs=runs, bound_m=bound_m, filter_m=filter_m, batch_m=batch_m if batch else None,
        predicted_m=predicted_m, nees=float(means[4]), nees_band=(low, high),
    )  # fmt: skip

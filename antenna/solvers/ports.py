"""Port quantities of an array: admittances, fields for one volt each, voltages of a feeding policy.

They are computed by the batch solver, which drives one element at a time while the other sources are shorted.
Its currents are the few per element: currents of near elements, for which patterns use all segments
(`antenna.solvers.batch.near`), are projected on them, with an error of 0.02 dB of gain (four half-wave
dipoles, two of them a hundredth of a wavelength apart; 0.0002 dB for short dipoles).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from antenna.model.config import AntennaConfig
from antenna.model.excitation import end_fire, hansen_woodyard, optimum
from antenna.model.geometry import Array, Complex, ElementsTouch, Snapshot, Voltages, upright
from antenna.solvers.batch.coupling import solve_arrays
from antenna.solvers.batch.kind import ElementKind, make_kind
from antenna.solvers.batch.moments import ETA_OHM

MAIN_LOBE_DEG = (90.0, 90.0)
"""Theta and phi of +y, the nominal direction of the main lobe."""
LEAST_GAIN = 1e-6
"""Linear gain of an element with shorted neighbours below which it counts as not radiating in a direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Ports:
    """Admittances and fields of an array of n elements.

    With voltages v (n,) the gain is 4 pi |F v|^2 / (eta v^H Re(Y) v).
    """

    admittance_s: Complex
    """(n, n) Y: current into source i for 1 V at source j; symmetric except for the solver's error of 1e-3 of
    the greatest for long dipoles, as point matching is not exactly reciprocal."""
    fields: Complex
    """(2, n) F: far field in the theta and phi polarisations, times distance, for 1 V; dimensionless."""

    def gain(self, voltages: Voltages) -> float:
        """Return the linear gain in the direction of the fields."""
        power_w = 0.5 * float((voltages.conj() @ self.admittance_s @ voltages).real)
        intensity_w = float((np.abs(self.fields @ voltages) ** 2).sum()) / (2.0 * ETA_OHM)
        return 4.0 * np.pi * intensity_w / power_w


def ports(
    snapshot: Snapshot, config: AntennaConfig, towards_deg: tuple[float, float] = MAIN_LOBE_DEG
) -> Ports:
    """Return the port quantities of a snapshot for a direction (theta, phi); its voltages are not used.

    Raises `ElementsTouch`, and ValueError over real ground, which the batch solver does not support.
    """
    if config.ground == "real":
        raise ValueError(
            "excitation: port admittances need the batch solver, which does not support real ground"
        )
    n, kind = len(snapshot.voltages), _kind(config)
    currents, power_w = np.zeros((n, n, len(kind.feed_a)), complex), np.zeros(n)
    nearest, nearest_m = np.empty((n, 2), np.int64), np.empty(n)
    solve_arrays(
        kind, np.tile(snapshot.centres_m, (n, 1, 1)), np.tile(snapshot.rotations, (n, 1, 1, 1)),
        np.eye(n, dtype=complex), currents, power_w, nearest, nearest_m,
    )  # fmt: skip
    if nearest_m[0] <= kind.clearance_m:
        raise ElementsTouch(int(nearest[0, 0]), int(nearest[0, 1]), float(nearest_m[0]))
    finest = slice(int(kind.firsts[-2]), int(kind.firsts[-1]))
    places_m = (
        np.einsum("nxy,my->nmx", snapshot.rotations, kind.places_m[finest]) + snapshot.centres_m[:, None]
    )
    axes = np.einsum("nxy,my->nmx", snapshot.rotations, kind.axes[finest])
    moments_am = currents @ kind.moments_am[finest].T  # (driven, element, point)
    theta_hat, phi_hat, towards = _directions(*towards_deg)
    phase = np.exp(1j * kind.k_rad_m * (places_m @ towards))
    across = np.stack([axes @ theta_hat, axes @ phi_hat]) * phase
    if kind.image:
        mirror = np.array([1.0, 1.0, -1.0])
        phase = np.exp(1j * kind.k_rad_m * (places_m @ (mirror * towards)))
        across += np.stack([axes @ (-mirror * theta_hat), axes @ (-mirror * phi_hat)]) * phase
    scale = ETA_OHM * kind.k_rad_m / (4.0 * np.pi)
    fields: Complex = -1j * scale * np.einsum("dnm,pnm->pd", moments_am, across)
    return Ports(np.ascontiguousarray((currents @ kind.feed_a).T), fields)


def feed(
    positions_m: Array, config: AntennaConfig, rotations: Array | None = None, *,
    places_m: Array | None = None,
) -> Voltages:  # fmt: skip
    """Return voltages (n,) by ``config.excitation`` for elements at positions (n, 3), main lobe along +y.

    ``rotations`` (n, 3, 3), by default upright, are used only by the optimum. ``places_m`` (n, 3), by default
    the positions, are used only by Hansen-Woodyard. Raises `ElementsTouch`, and ValueError if a policy is not
    applicable.
    """
    match config.excitation:
        case "end_fire":
            return end_fire(positions_m, config.wavelength_m)
        case "hansen_woodyard":
            return hansen_woodyard(positions_m, config.wavelength_m, places_m)
        case "optimum":
            array = upright(positions_m, np.ones(len(positions_m), complex))
            if rotations is not None:
                array = replace(array, rotations=rotations)
            seen = ports(array, config)
            if max(seen.gain(one) for one in np.eye(len(positions_m), dtype=complex)) < LEAST_GAIN:
                raise ValueError(
                    "excitation: the elements do not radiate along +y, so there are no optimum weights"
                )
            return optimum(0.5 * (seen.admittance_s + seen.admittance_s.T).real, seen.fields)


def _directions(theta_deg: float, phi_deg: float) -> tuple[Array, Array, Array]:
    """Return the unit vectors of theta, phi and the direction."""
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    theta_hat = np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
    phi_hat = np.array([-np.sin(phi), np.cos(phi), 0.0])
    towards = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return theta_hat, phi_hat, towards


@lru_cache(maxsize=8)
def _kind(config: AntennaConfig) -> ElementKind:
    return make_kind(config.element(), config.wavelength_m, image=config.ground == "perfect")

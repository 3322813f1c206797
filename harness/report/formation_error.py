"""Absolute and shape error of the flown formation against the desired one."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.records.flight import Flight

_AT_ONCE = 8_192
"""Instants that are computed together, to limit the memory; each has the same result as alone"""


class _Errors(NamedTuple):
    """Arrays of an `ErrorSeries`."""

    error_m: Array
    horizontal_m: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSeries:
    """Distances of N vehicles from their places at T instants."""

    error_m: Array
    """(T, N) in three dimensions; 0 where not ``valid``."""
    horizontal_m: Array
    """(T, N) horizontal part."""
    valid: NDArray[np.bool_]
    """(T, N) whether an error is defined."""
    rms_m: float | None
    """RMS over time and vehicles of the whole flight; None without valid errors."""

    def at(self, rows: NDArray[np.int64] | slice) -> "ErrorSeries":
        """Return the errors at some instants, with the RMS of the whole flight."""
        return ErrorSeries(self.error_m[rows], self.horizontal_m[rows], self.valid[rows], self.rms_m)

    @property
    def horizontal_rms_m(self) -> float | None:
        """RMS of the horizontal part."""
        return _rms(self.horizontal_m, self.valid)

    @property
    def vehicle_rms_m(self) -> tuple[float | None, ...]:
        """RMS over time of each vehicle."""
        return tuple(_rms(self.error_m[:, i], self.valid[:, i]) for i in range(self.valid.shape[1]))


@dataclass(frozen=True, slots=True, eq=False)
class FormationError:
    """Errors of a flight: see `formation_error`."""

    absolute: ErrorSeries
    """Distances from the desired places, of living vehicles."""
    shape: ErrorSeries
    """Distances from the aligned desired formation, at instants with two or more living vehicles."""
    yaw_rad: Array
    """(T,) clockwise rotation of the flown against the desired formation; 0 with fewer than two vehicles."""

    def at(self, rows: NDArray[np.int64] | slice) -> "FormationError":
        """Return the errors at some instants."""
        return FormationError(self.absolute.at(rows), self.shape.at(rows), self.yaw_rad[rows])


def formation_error(flight: Flight) -> FormationError:
    """Return the absolute error and the shape error of every vehicle at every instant.

    Heights of places, as autopilots', are relative to the landed vehicle; true heights are those of its
    centre of mass above the ground. So ``flight.standing_height_m`` is no error.

    The shape error remains after the translation and the rotation about the vertical that align the places of
    the living vehicles with their positions in the least-squares sense.
    """
    shape, yaw_rad = flight.alive.shape, np.empty(len(flight))
    absolute, aligned = (
        _Errors(np.empty(shape), np.empty(shape), np.empty(shape, np.bool_)) for _ in range(2)
    )
    for first in range(0, len(flight), _AT_ONCE):
        rows = slice(first, min(first + _AT_ONCE, len(flight)))
        part = flight.at(np.arange(rows.start, rows.stop))
        found = _errors(part)
        yaw_rad[rows] = found[2]
        for target, source in ((absolute, found[0]), (aligned, found[1])):
            for whole, new in zip(target, source, strict=True):
                whole[rows] = new
    return FormationError(absolute=_series(absolute), shape=_series(aligned), yaw_rad=yaw_rad)


def _series(errors: _Errors) -> ErrorSeries:
    return ErrorSeries(*errors, _rms(errors.error_m, errors.valid))


def _errors(flight: Flight) -> tuple[_Errors, _Errors, Array]:
    """Return absolute and shape errors, and the rotations."""
    alive = flight.alive
    aligned_ned_m, yaw_rad = _align(flight)
    over_its_place_ned_m = np.zeros((alive.shape[1], 3))
    over_its_place_ned_m[:, 2] -= flight.standing_height_m
    shape_defined = alive & (alive.sum(axis=1, keepdims=True) >= 2)
    return (
        _lengths(flight.pos_ned_m - flight.desired_pos_ned_m - over_its_place_ned_m, alive),
        _lengths(flight.pos_ned_m - aligned_ned_m, shape_defined),
        yaw_rad,
    )


def rotation_rad(flown: NDArray[np.complex128], desired: NDArray[np.complex128]) -> Array:
    """Return the clockwise rotations (T,) that align the desired with the flown places best.

    Both are (T, N) or, if constant, (N,), in metres relative to their mean, as complex numbers north + j
    east. This is the closed form of Kabsch's problem in the plane: the angle of sum_i a_i^* b_i, with a_i
    desired and b_i flown.
    """
    angle_rad: Array = np.angle((desired.conj() * flown).sum(axis=1))
    return angle_rad


def _align(flight: Flight) -> tuple[Array, Array]:
    """Return the desired places (T, N, 3) aligned with the flown ones, and the rotation angle (T,).

    The best translation maps mean to mean.
    """
    counted = flight.alive[..., np.newaxis]
    living = np.maximum(counted.sum(axis=1, keepdims=True), 1)
    pos_mean_ned_m = np.where(counted, flight.pos_ned_m, 0.0).sum(axis=1, keepdims=True) / living
    desired_mean_ned_m = np.where(counted, flight.desired_pos_ned_m, 0.0).sum(axis=1, keepdims=True) / living
    pos_ned_m = np.where(counted, flight.pos_ned_m - pos_mean_ned_m, 0.0)
    desired_ned_m = flight.desired_pos_ned_m - desired_mean_ned_m

    flown = pos_ned_m[..., 0] + 1j * pos_ned_m[..., 1]
    desired = desired_ned_m[..., 0] + 1j * desired_ned_m[..., 1]
    yaw_rad = rotation_rad(flown, desired)
    turned = desired * np.exp(1j * yaw_rad)[:, np.newaxis]
    return np.stack([turned.real, turned.imag, desired_ned_m[..., 2]], axis=-1) + pos_mean_ned_m, yaw_rad


def _lengths(difference_ned_m: Array, valid: NDArray[np.bool_]) -> _Errors:
    counted_ned_m = np.where(valid[..., np.newaxis], difference_ned_m, 0.0)
    return _Errors(
        error_m=np.linalg.norm(counted_ned_m, axis=-1),
        horizontal_m=np.linalg.norm(counted_ned_m[..., :2], axis=-1),
        valid=valid,
    )


def _rms(values: Array, valid: NDArray[np.bool_]) -> float | None:
    return float(np.sqrt(np.mean(values[valid] ** 2))) if valid.any() else None

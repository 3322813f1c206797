"""Effect of a channel outage and of a vehicle with biased ranging on a formation, from its track."""

import math

import numpy as np
from msgspec import Struct

from foundation.types import Array
from harness.report.formation_error import rotation_rad
from studies.codesign.measures import TRACK_PERIOD_S

SMOOTHED_S = 1.0
"""Recovery is judged by the rms over this time, ..."""
SETTLED_S = 3.0
"""... which must stay small for this time, or to the end if that is earlier."""
RECOVERED_FACTOR = 1.2
RECOVERED_M = 0.25
PULL_WINDOW_S = 2.0
"""A displacement is a mean over this time, which suppresses the effect of single gusts and distances."""


class CutResult(Struct, frozen=True, kw_only=True):
    """Horizontal shape error around an outage, rms; metres and seconds."""

    before_m: float
    during_m: float
    after_m: float
    """After the recovery; NaN without one"""
    recovery_s: float
    """From the channel's return to the recovery; infinite without one"""
    largest_during_m: float
    """Over the last `SMOOTHED_S`; NaN without a track"""
    largest_after_m: float
    """Likewise, after the channel's return"""
    left: bool
    """Whether the error left its bounds after the start of the outage; otherwise no recovery was needed"""


class Pull(Struct, frozen=True, kw_only=True):
    """Effect of one biased vehicle on the others, relative to the flight without bias; horizontal, metres."""

    shape_m: float
    """Shape error of the others with the bias, rms"""
    shape_without_m: float
    displacement_m: float
    """Largest displacement of one of them in their shape, mean over `PULL_WINDOW_S`"""
    lasting_m: float
    """Largest displacement of one of them in their shape, mean over the whole time"""
    shift_m: float
    """Largest displacement of the others' centre, mean over `PULL_WINDOW_S`"""
    turn_deg: float
    """Largest common rotation of the others, mean over `PULL_WINDOW_S`"""
    moved_m: float
    """Largest displacement of one of them in space, mean over `PULL_WINDOW_S`, with shift and turn"""


def shape_errors_ne_m(track_ne_m: Array, places_ned_m: Array) -> Array:
    """Return the errors (T, N, 2) after alignment, in the frame of the desired formation.

    The track (T, N, 2) is relative to the places (N, 3) of the vehicles.
    """
    return _aligned(track_ne_m, places_ned_m)[0]


def _aligned(track_ne_m: Array, places_ned_m: Array) -> tuple[Array, Array]:
    """Return the errors of `shape_errors_ne_m` and the removed rotations (T,) as unit complex numbers."""
    places = places_ned_m[:, 0] + 1j * places_ned_m[:, 1]
    flown = places + track_ne_m[..., 0] + 1j * track_ne_m[..., 1]
    flown -= flown.mean(axis=1, keepdims=True)
    desired = places - places.mean()
    turn = np.exp(1j * rotation_rad(flown, desired))
    left = flown * turn[:, None].conj() - desired
    return np.stack((left.real, left.imag), axis=-1), turn


def shape_over_time_m(track_ne_m: Array, places_ned_m: Array) -> Array:
    """Return the horizontal shape error (T,), rms over the vehicles."""
    square = (shape_errors_ne_m(track_ne_m, places_ned_m) ** 2).sum(axis=-1)
    return np.asarray(np.sqrt(square.mean(axis=1)))


def judge_cut(shape_m: Array, *, cut_at_s: float, cut_s: float) -> CutResult:
    """Evaluate an outage from shape errors (T,) every `TRACK_PERIOD_S`, starting at the formation.

    The formation has recovered when the rms of the error over the last `SMOOTHED_S` falls below
    `RECOVERED_FACTOR` times its value before the outage, or `RECOVERED_M` if that is larger, and stays there
    for `SETTLED_S`.
    """
    cut, back = round(cut_at_s / TRACK_PERIOD_S), round((cut_at_s + cut_s) / TRACK_PERIOD_S)
    before_m = _rms(shape_m[:cut])
    limit_m = max(RECOVERED_FACTOR * before_m, RECOVERED_M)
    smooth_m = np.sqrt(_running_mean(shape_m**2, round(SMOOTHED_S / TRACK_PERIOD_S)))
    stays = round(SETTLED_S / TRACK_PERIOD_S)
    small = smooth_m[back:] <= limit_m
    recovered = next((k for k in range(len(small)) if small[k : k + stays].all()), None)
    return CutResult(
        before_m=before_m,
        during_m=_rms(shape_m[cut:back]),
        after_m=math.nan if recovered is None else _rms(shape_m[back + recovered :]),
        recovery_s=math.inf if recovered is None else recovered * TRACK_PERIOD_S,
        largest_during_m=_largest(smooth_m[cut:back]),
        largest_after_m=_largest(smooth_m[back:]),
        left=bool((smooth_m[cut:] > limit_m).any()),
    )


def judge_liar(
    track_ne_m: Array, without_ne_m: Array, places_ned_m: Array, *, liar: int, from_s: float
) -> Pull:
    """Compare two tracks (T, N, 2) of one seed from ``from_s`` after the formation, except the biased UAV.

    All results are NaN if a track ends before that.
    """
    begin = round(from_s / TRACK_PERIOD_S)
    length = min(len(track_ne_m), len(without_ne_m))
    if length <= begin:
        return Pull(**dict.fromkeys(Pull.__struct_fields__, math.nan))
    others = [i for i in range(len(places_ned_m)) if i != liar]
    places_ned_m = places_ned_m[others]
    with_ne_m, without_ne_m = (each[begin:length][:, others] for each in (track_ne_m, without_ne_m))
    errors_ne_m, turn = _aligned(with_ne_m, places_ned_m)
    usual_ne_m, usual_turn = _aligned(without_ne_m, places_ned_m)
    pulled_ne_m, moved_ne_m = errors_ne_m - usual_ne_m, with_ne_m - without_ne_m
    turned_deg = np.degrees(np.angle(turn * usual_turn.conj()))

    def largest(difference_ne_m: Array) -> float:
        window = round(PULL_WINDOW_S / TRACK_PERIOD_S)
        return _largest(np.linalg.norm(_running_mean(difference_ne_m, window), axis=-1))

    return Pull(
        shape_m=_rms(np.linalg.norm(errors_ne_m, axis=-1)),
        shape_without_m=_rms(np.linalg.norm(usual_ne_m, axis=-1)),
        displacement_m=largest(pulled_ne_m),
        lasting_m=float(np.linalg.norm(pulled_ne_m.mean(axis=0), axis=-1).max()),
        shift_m=largest(moved_ne_m.mean(axis=1)),
        turn_deg=largest(turned_deg[:, None]),
        moved_m=largest(moved_ne_m),
    )


def _running_mean(values: Array, window: int) -> Array:
    """Return the mean of the last ``window`` rows at every row; of fewer at the first rows."""
    sums = np.cumsum(values, axis=0)
    sums[window:] = sums[window:] - sums[:-window]
    counts = np.minimum(np.arange(1, len(values) + 1), window)
    return np.asarray(sums / counts.reshape(-1, *[1] * (values.ndim - 1)))


def _largest(values: Array) -> float:
    return float(values.max()) if values.size else math.nan


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan

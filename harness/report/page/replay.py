"""Data of the 3-D replay: positions, places and links at a few instants per second."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.report.page.encoding import packed, singles
from harness.report.vehicle_colours import vehicle_colours

RATES_HZ = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
MOST_INSTANTS = 1_500
MOST_POSITIONS = 60_000
"""Positions of all vehicles together"""
MOST_LINKS = 400_000
"""Entries of links; with more the last instants have none"""
MERGED_AT = 100_000
"""Entries of links that are collected before they are merged, at least"""
FRAME_COLUMNS = ("end_ns", "source", "destination", "kind", "delivered", "collided", "lost_to_noise")
"""Columns of ``radio.parquet`` that are read"""
SESSION_COLUMNS = ("measured_ns", "initiator", "peer", "status")
FLATTEST = 0.25
"""Least height of the scene over its width; a flatter one is stretched"""
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
RANGED, SENT = 0, 2
"""Codes of links: sessions and datagrams to one receiver; 1 is added if some of them failed"""


def replay_rows(time_s: NDArray[Any], vehicles: int) -> tuple[NDArray[np.int64], float]:
    """Return the recorded instants that are replayed, and their rate in Hz; 0 Hz: fewer than two."""
    if len(time_s) < 2:
        return np.arange(len(time_s)), 0.0
    most = max(2, min(MOST_INSTANTS, MOST_POSITIONS // max(vehicles, 1)))
    duration_s = float(time_s[-1] - time_s[0])
    rate_hz = next((rate for rate in RATES_HZ if duration_s * rate <= most), most / duration_s)
    wanted_s = time_s[0] + np.arange(int(duration_s * rate_hz) + 1) / rate_hz
    rows = np.unique(np.searchsorted(time_s, np.append(wanted_s - 1e-6, time_s[-1])))
    rows = rows[rows < len(time_s)]
    return rows, min(rate_hz, (len(time_s) - 1) / duration_s)


class Links:
    """Links at the instants of a replay, from batches: what was ranged and sent in the time before each."""

    def __init__(self, time_s: NDArray[Any], vehicles: int) -> None:
        self._ends_s, self._vehicles = time_s, vehicles
        self._states = np.empty(0, np.int64)
        """(instant, first, second, kind and whether one failed), each as one number; sorted"""
        self._added: list[NDArray[np.int64]] = []
        """Such numbers that are not merged yet"""
        self._heard = np.zeros((len(time_s), vehicles, 2), np.int64)
        """Receivers that group frames of each vehicle reached and did not reach"""

    def add_sessions(self, sessions: Mapping[str, NDArray[Any]], texts: Sequence[str]) -> None:
        """Add ranging sessions: arrays of `SESSION_COLUMNS`; ``texts`` are those of the codes of status."""
        fine = np.array([text == "ok" for text in texts], np.bool_)[sessions["status"]]
        self._add(sessions["measured_ns"], sessions["initiator"], sessions["peer"], fine, RANGED)

    def add_frames(self, frames: Mapping[str, NDArray[Any]], texts: Sequence[str]) -> None:
        """Add frames: arrays of `FRAME_COLUMNS`; ``texts`` are those of the codes of kinds."""
        is_data = frames["kind"] == (texts.index("data") if "data" in texts else -1)
        to_one = is_data & (frames["destination"] >= 0)
        self._add(
            frames["end_ns"][to_one],
            frames["source"][to_one],
            frames["destination"][to_one],
            frames["delivered"][to_one] > 0,
            SENT,
        )
        to_all = is_data & (frames["destination"] < 0) & (frames["source"] < self._vehicles)
        instants = np.searchsorted(self._ends_s, frames["end_ns"][to_all] / 1e9)
        inside = instants < len(self._ends_s)
        at = instants[inside], frames["source"][to_all][inside]
        np.add.at(self._heard[..., 0], at, frames["delivered"][to_all][inside])
        lost = frames["collided"] + frames["lost_to_noise"]
        np.add.at(self._heard[..., 1], at, lost[to_all][inside])

    def _add(
        self,
        time_ns: NDArray[Any],
        first: NDArray[Any],
        second: NDArray[Any],
        fine: NDArray[np.bool_],
        kind: int,
    ) -> None:
        n = self._vehicles
        instants = np.searchsorted(self._ends_s, time_ns / 1e9)
        known = (instants < len(self._ends_s)) & (first < n) & (second < n) & (first >= 0) & (second >= 0)
        low, high = np.minimum(first, second)[known], np.maximum(first, second)[known]
        self._added.append(
            np.unique(((instants[known] * n + low) * n + high) * 4 + kind + ~fine[known]).astype(np.int64)
        )
        if sum(map(len, self._added)) > max(MERGED_AT, len(self._states)):
            self._merge()

    def _merge(self) -> None:
        """Merge what was added, and drop what `content` cannot give."""
        self._states = np.unique(np.concatenate([self._states, *self._added]))[: 2 * (MOST_LINKS + 1)]
        self._added = []

    def until_s(self) -> float | None:
        """Return the time up to which `content` has all links; None: all of them."""
        self._merge()
        links = np.unique(self._states // 2)
        if len(links) <= MOST_LINKS:
            return None
        last = int(links[MOST_LINKS] // (2 * self._vehicles**2)) - 1
        return float(self._ends_s[last]) if last >= 0 else float(self._ends_s[0])

    def content(self) -> dict[str, Any]:
        """Return, for the script, the links of each instant, and the shares of lost group frames (K, N)."""
        n = self._vehicles
        self._merge()
        is_last = np.diff(self._states // 2, append=-1) != 0  # the failure, of a link with successes too
        states = self._states[is_last][:MOST_LINKS]
        pairs, codes = states // 4, states % 4
        instants = pairs // (n * n)
        total = self._heard.sum(axis=-1)
        share = np.where(total > 0, 255.0 * self._heard[..., 1] / np.maximum(total, 1), 0.0)
        return {
            "starts": packed(np.searchsorted(instants, np.arange(len(self._ends_s) + 1)).astype(np.int32)),
            "first": packed((pairs // n % n).astype(np.uint8)),
            "second": packed((pairs % n).astype(np.uint8)),
            "state": packed(codes.astype(np.uint8)),
            "lost": packed(np.ceil(share).astype(np.uint8)),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """Positions of N vehicles at K instants; site NED."""

    time_s: NDArray[np.float64]
    """(K,)"""
    rate_hz: float
    pos_ned_m: NDArray[Any]
    """(K, N, 3)"""
    desired_pos_ned_m: NDArray[Any]
    """(K, N, 3)"""
    believed_pos_ned_m: NDArray[Any]
    """(K, N, 3), NaN if unknown"""
    alive: NDArray[np.bool_]
    """(K, N)"""
    links: Links = field(repr=False)

    def content(self) -> dict[str, Any]:
        """Return the data for the script, in east, north and up."""
        n = self.pos_ned_m.shape[1]
        fixed = not (self.desired_pos_ned_m != self.desired_pos_ned_m[0]).any()
        places = self.desired_pos_ned_m[:1] if fixed else self.desired_pos_ned_m
        low, high = self._extent()
        size = np.maximum(high - low, 1e-9)
        widest = float(size[:2].max())
        height = max(float(size[2]), FLATTEST * widest)
        return {
            "time": singles(self.time_s),
            "pos": singles(self.pos_ned_m @ _ENU_FROM_NED.T),
            "places": singles(places @ _ENU_FROM_NED.T),
            "places_fixed": fixed,
            "believed": singles(self.believed_pos_ned_m @ _ENU_FROM_NED.T)
            if np.isfinite(self.believed_pos_ned_m).any()
            else None,
            "alive": packed(self.alive.astype(np.uint8)),
            "links": self.links.content(),
            "vehicles": n,
            "colours": vehicle_colours(n),
            "range": [[float(low[k]), float(high[k])] for k in range(3)],
            "aspect": _aspect([float(size[0]), float(size[1]), height]),
            "stretch": round(height / float(size[2]), 3),
        }

    def _extent(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the least and greatest east, north and up of living vehicles and places, with a margin."""
        counted = self.alive & np.isfinite(self.pos_ned_m).all(axis=-1)
        points = (
            np.concatenate([self.pos_ned_m[counted], self.desired_pos_ned_m.reshape(-1, 3)]) @ _ENU_FROM_NED.T
        )
        low, high = points.min(axis=0), points.max(axis=0)
        low[2] = min(low[2], 0.0)
        margin = 0.05 * max(float((high - low).max()), 1.0)
        return low - margin * np.array([1.0, 1.0, 0.0]), high + margin


def _aspect(size_m: list[float]) -> list[float]:
    """Return the sides of the scene, whose volume is 1 unless it is very long or narrow."""
    widest = max(size_m)
    sides = [max(each, 0.05 * widest) for each in size_m]
    mean = (sides[0] * sides[1] * sides[2]) ** (1.0 / 3.0)
    return [min(each / mean, 2.6) for each in sides]

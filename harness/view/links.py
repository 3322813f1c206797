"""Links while they carry frames, and measured distances, as lines between vehicles.

A frame to one station is a line to it. A broadcast that every living vehicle received is a line to each; of
another the records have numbers of receivers only, so its transmitter is marked by the worst outcome.
"""

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.records.pieces import Rows
from harness.view.entries import Colour, Entry

DELIVERED: Colour = (70, 200, 90)
COLLIDED: Colour = (235, 60, 60)
LOST: Colour = (240, 170, 50)
RANGE: Colour = (190, 120, 255)
_OUTCOMES = (("delivered", DELIVERED), ("collided", COLLIDED), ("lost", LOST))


def outcomes(frames: Rows) -> NDArray[np.int64]:
    """Return (n,) the worst outcome of each frame: an index of delivered, collided, lost; -1: no receiver."""
    found = np.full(len(frames), -1)
    for number, name in enumerate(("delivered", "collided", "lost_to_noise")):
        found[frames[name] > 0] = number
    return found


def instants(times_ns: NDArray[np.int64], times_us: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return (n,) the index of the next of the instants (T,) for times; the last for what is after it."""
    return np.minimum(np.searchsorted(times_us * 1_000, times_ns), len(times_us) - 1)


def link_entries(frames: Rows, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
    """Return lines and marks of frames at each of the instants; ``flight`` is (T, N)."""
    vehicles = flight.shape[1]
    frames = frames[(frames["source"] < vehicles) & (frames["destination"] < vehicles)]
    at, outcome = instants(frames["end_ns"], times_us), outcomes(frames)
    source, destination = frames["source"], frames["destination"]
    group = destination < 0
    alive = flight["alive"]
    to_all = group & (outcome == 0) & (frames["delivered"] >= alive[at].sum(axis=1) - 1)
    found = []
    for number, (name, colour) in enumerate(_OUTCOMES):
        lines = np.zeros((len(times_us), vehicles, vehicles), np.bool_)
        single = ~group & (outcome == number)
        lines[at[single], source[single], destination[single]] = True
        if number == 0:
            lines[at[to_all], source[to_all]] |= alive[at[to_all]]
        marks = np.zeros((len(times_us), vehicles), np.bool_)
        some = group & ~to_all & (outcome == number)
        marks[at[some], source[some]] = True
        lines[:, np.arange(vehicles), np.arange(vehicles)] = False
        found += [
            _lines(f"world/links/{name}", lines, flight, times_us, colour),
            _marks(f"world/links/broadcast_{name}", marks, flight, times_us, colour),
        ]
    return found


def range_entries(sessions: Rows, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
    """Return lines of the measured distances, with the distance as their label."""
    vehicles = flight.shape[1]
    done = sessions[(sessions["status"] == b"ok") & (sessions["peer"] < vehicles)]
    done = done[done["initiator"] < vehicles]
    at = instants(done["measured_ns"], times_us)
    done, at = done[np.argsort(at, kind="stable")], np.sort(at)
    ends = np.stack(
        [flight["pos_ned_m"][at, done["initiator"]], flight["pos_ned_m"][at, done["peer"]]], axis=1
    )
    labels = [
        f"{distance_m:.2f} m ({distance_m - true_m:+.2f})"
        for distance_m, true_m in zip(
            done["distance_m"].tolist(), done["true_distance_m"].tolist(), strict=True
        )
    ]
    return [
        Entry(
            path="world/ranges",
            kind="LineStrips3D",
            times_us=times_us,
            lengths=np.bincount(at, minlength=len(times_us)),
            fields={
                "strips": ends,
                "labels": labels,
                "show_labels": np.zeros(len(ends), np.bool_),
                "colors": _colours(RANGE, len(ends)),
                "radii": np.full(len(ends), -1.0),
            },
        )
    ]


def _lines(
    path: str, lines: NDArray[np.bool_], flight: Rows, times_us: NDArray[np.int64], colour: Colour
) -> Entry:
    """Return lines (T, N, N) from vehicle to vehicle."""
    t, source, destination = np.nonzero(lines)
    pos_ned_m: Array = flight["pos_ned_m"]
    ends = np.stack([pos_ned_m[t, source], pos_ned_m[t, destination]], axis=1)
    fields = {"strips": ends, "colors": _colours(colour, len(ends)), "radii": np.full(len(ends), -1.2)}
    lengths = lines.sum(axis=(1, 2))
    return Entry(path=path, kind="LineStrips3D", times_us=times_us, fields=fields, lengths=lengths)


def _marks(
    path: str, marks: NDArray[np.bool_], flight: Rows, times_us: NDArray[np.int64], colour: Colour
) -> Entry:
    """Return marks (T, N) at vehicles."""
    places = flight["pos_ned_m"][marks]
    fields = {
        "positions": places,
        "colors": _colours(colour, len(places)),
        "radii": np.full(len(places), -8.0),
    }
    return Entry(path=path, kind="Points3D", times_us=times_us, fields=fields, lengths=marks.sum(axis=1))


def _colours(colour: Colour, count: int) -> NDArray[np.uint8]:
    return np.tile(np.array(colour, np.uint8), (count, 1))

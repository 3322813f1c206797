"""Read an element from a NEC deck, the text file of nec2c, xnec2c and 4nec2.

The reader supports CM, CE, GW, GM, GS, GE, EX 0, and EN, after which it stops. It skips cards that only
request results (FR, RP, XQ, PT, PQ, NE, NH) and rejects all others, with their line number. Numbers are
separated by blanks or commas; an empty field between two commas is 0, as in NEC's free format.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antenna.model.clearance import SEGMENT_MATCH, segment_distance_m
from antenna.model.elements import WIRE_LENGTH_M, WIRE_RADIUS_M, Element, Wire
from antenna.model.geometry import Array

_PASSED_OVER = {"CM", "CE", "FR", "RP", "XQ", "PT", "PQ", "NE", "NH"}
_INTEGERS = {"GW": 2, "GM": 2, "GS": 2, "EX": 4, "GE": 1}
_MOST_WIRES = 1_000
_GREATEST = 1e15
"""Largest absolute number in a deck, before and after GS, to avoid overflow before sizes are checked."""


class DeckError(ValueError):
    """The deck cannot be read; the text is one line with the deck's line number."""


class _Placed(NamedTuple):
    """A wire of a deck while it is read."""

    tag: int
    wire: Wire
    line: int
    """Line of its GW card, from 1."""


def read_element(text: str) -> Element:
    """Return the element of a deck with wires and one source; raises DeckError."""
    wires: list[_Placed] = []
    source: tuple[int, int] | None = None
    number = 0
    for number, line in enumerate(text.splitlines(), start=1):
        card, fields = line[:2].upper(), line[2:]
        if card == "EN":
            break
        if not line.strip() or card in _PASSED_OVER:
            continue
        try:
            integers, reals = _fields(card, fields)
            match card:
                case "GW":
                    wires.append(_wire(integers, reals, number))
                case "GS":
                    wires = [placed._replace(wire=_scaled(placed.wire, reals[0])) for placed in wires]
                case "GM":
                    wires = _moved(wires, integers, reals)
                case "GE":
                    if integers[0] != 0:
                        raise ValueError("an element must not have a ground: expected GE 0")  # noqa: TRY301  # line added below
                case "EX":
                    if source is not None:
                        raise ValueError("second source; an element must have one")  # noqa: TRY301
                    if integers[0] != 0:
                        raise ValueError(f"source of kind {integers[0]}; expected 0, a voltage")  # noqa: TRY301
                    source = integers[1], integers[2]
                case _:
                    raise ValueError(f"card {card!r} is not supported")  # noqa: TRY301
        except ValueError as error:
            raise DeckError(f"line {number}: {error}") from None
        if len(wires) > _MOST_WIRES:
            raise DeckError(f"line {number}: more than {_MOST_WIRES} wires")
    if not wires:
        raise DeckError(f"line {number}: the deck has no wires")
    if source is None:
        raise DeckError(f"line {number}: the deck has no source (EX 0)")
    for placed in wires:
        _check_size(placed)
    _check_apart(wires)
    try:
        return Element(wires=tuple(placed.wire for placed in wires), feed_segment=_segment(wires, *source))
    except ValueError as error:
        raise DeckError(f"line {number}: {error}") from None


def _fields(card: str, text: str) -> tuple[list[int], list[float]]:
    """Return integers and reals of a card; missing ones are 0."""
    words = [word for field in text.strip().removeprefix(",").split(",") for word in field.split() or ["0"]]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"{card}: expected numbers, not {text.strip()[:40]!r}") from None
    if not all(abs(value) <= _GREATEST for value in numbers):  # also rejects NaN
        raise ValueError(f"{card}: expected finite numbers of at most {_GREATEST:g}")
    count = _INTEGERS.get(card, 0)
    integers, reals = [int(value) for value in numbers[:count]], numbers[count:]
    return integers + [0] * (count - len(integers)), reals + [0.0] * (7 - len(reals))


def _wire(integers: list[int], reals: list[float], line: int) -> _Placed:
    tag, segments = integers
    if not 1 <= segments <= 1_000:
        raise ValueError(f"GW: {segments} segments; expected 1 to 1000")
    if reals[6] <= 0.0:
        raise ValueError("GW: expected a radius above 0 (tapered wires, GC, are not supported)")
    start, end = (reals[0], reals[1], reals[2]), (reals[3], reals[4], reals[5])
    if start == end:
        raise ValueError("GW: wire of length 0")
    return _Placed(tag, Wire(start_m=start, end_m=end, radius_m=reals[6], segments=segments), line)


def _scaled(wire: Wire, factor: float) -> Wire:
    if factor <= 0.0:
        raise ValueError(f"GS: expected a factor above 0, not {factor:g}")
    (a, b, c), (d, e, f), radius_m = wire.start_m, wire.end_m, wire.radius_m * factor
    start_m, end_m = (a * factor, b * factor, c * factor), (d * factor, e * factor, f * factor)
    if max(abs(value) for value in (*start_m, *end_m, radius_m)) > _GREATEST:
        raise ValueError(f"GS: expected lengths of at most {_GREATEST:g} m")
    return replace(wire, start_m=start_m, end_m=end_m, radius_m=radius_m)


def _moved(wires: list[_Placed], integers: list[int], reals: list[float]) -> list[_Placed]:
    """Apply GM: rotate about x, then y, then z, and translate all wires, or add copies of them."""
    increment, copies = integers
    if not 0 <= copies <= _MOST_WIRES:
        raise ValueError(f"GM: {copies} copies; expected 0 to {_MOST_WIRES}")
    if reals[6]:
        raise ValueError("GM: moving wires from a tag on is not supported; expected 0 (all wires)")
    a, b, c = (math.radians(angle) for angle in reals[:3])
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    turn, shift = about_z @ about_y @ about_x, np.array(reals[3:6])

    def move(placed: _Placed) -> _Placed:
        tag, wire, line = placed
        start, end = (tuple((turn @ np.array(p) + shift).tolist()) for p in (wire.start_m, wire.end_m))
        return _Placed(tag + increment if tag else 0, replace(wire, start_m=start, end_m=end), line)

    if copies == 0:
        return [move(placed) for placed in wires]
    last, found = wires, list(wires)
    for _ in range(copies):
        last = [move(placed) for placed in last]
        found += last
        if len(found) > _MOST_WIRES:
            break
    return found


def _segment(wires: list[_Placed], tag: int, number: int) -> int:
    """Return the index over all wires of segment ``number``, from 1, of the wires with a tag; 0: all."""
    first, left = 0, number
    for own, wire, _ in wires:
        if tag in (0, own):
            if 1 <= left <= wire.segments:
                return first + left - 1
            left -= wire.segments
        first += wire.segments
    raise ValueError(f"EX: tag {tag} has no segment {number}")


def _check_size(placed: _Placed) -> None:
    """Raise DeckError unless a wire's size and distance from the vehicle are within the limits."""
    wire = placed.wire
    sizes = (("length", wire.length_m, WIRE_LENGTH_M), ("radius", wire.radius_m, WIRE_RADIUS_M))
    for name, size_m, (least_m, most_m) in sizes:
        if not least_m <= size_m <= most_m:
            raise DeckError(
                f"line {placed.line}: GW: {name} of {size_m:g} m; expected {least_m:g} to {most_m:g}"
            )
    farthest_m = max(math.hypot(*end_m) for end_m in (wire.start_m, wire.end_m))
    if farthest_m > WIRE_LENGTH_M[1]:
        raise DeckError(
            f"line {placed.line}: GW: end {farthest_m:g} m from the vehicle;"
            f" expected at most {WIRE_LENGTH_M[1]:g}"
        )


def _check_apart(wires: list[_Placed]) -> None:
    """Raise DeckError if two wires touch or cross elsewhere than at an end of both.

    The distance is that of `antenna.model.clearance.clearance_m`. NEC2 does not detect overlapping wires,
    even identical ones, and PyNEC rejects wires that cross, also at segments' ends.
    """
    ends_m = np.array([(wire.start_m, wire.end_m) for _, wire, _ in wires])
    middles_m, halves_m = ends_m.mean(axis=1), np.array([0.5 * wire.length_m for _, wire, _ in wires])
    radii_m = np.array([wire.radius_m for _, wire, _ in wires])
    segments_m = np.array([wire.length_m / wire.segments for _, wire, _ in wires])
    for b in range(1, len(wires)):
        apart_m = radii_m[:b] + radii_m[b] + SEGMENT_MATCH * np.maximum(segments_m[:b], segments_m[b])
        between_m = np.linalg.norm(middles_m[:b] - middles_m[b], axis=1) - halves_m[:b] - halves_m[b]
        near = np.flatnonzero(between_m <= apart_m)
        match_m = SEGMENT_MATCH * np.minimum(segments_m[near], segments_m[b])
        joined = _joined(ends_m[near], ends_m[b], match_m, apart_m[near])
        for a in near[~joined].tolist():
            if segment_distance_m(*ends_m[a], *ends_m[b]) <= apart_m[a]:
                first, second = wires[a].line, wires[b].line
                other = "its own copy" if first == second else f"that of line {first}"
                raise DeckError(
                    f"line {second}: GW: the wire touches or crosses {other};"
                    " wires may meet only at ends of both"
                )


def _joined(wires_m: Array, other_m: Array, match_m: Array, apart_m: Array) -> NDArray[np.bool_]:
    """Return whether wires (n, 2, 3) share one end with another (2, 3), with their other ends apart.

    The other ends are more than ``apart_m`` (n,) from the other wire; ``match_m`` (n,) is the largest
    distance of joined ends.
    """
    met = np.linalg.norm(wires_m[:, :, None] - other_m, axis=-1) < match_m[:, None, None]
    others_m = np.broadcast_to(other_m, wires_m.shape)
    mine = (_distances_m(wires_m, others_m) > apart_m[:, None]) | met.any(axis=2)
    its = (_distances_m(others_m, wires_m) > apart_m[:, None]) | met.any(axis=1)
    return np.asarray((met.sum(axis=(1, 2)) == 1) & mine.all(axis=1) & its.all(axis=1))


def _distances_m(points_m: Array, wires_m: Array) -> Array:
    """Return the distances (n, 2) of two points each (n, 2, 3) from wires (n, 2, 3)."""
    along_m, from_m = wires_m[:, 1] - wires_m[:, 0], points_m - wires_m[:, :1]
    share = np.einsum("nex,nx->ne", from_m, along_m) / np.einsum("nx,nx->n", along_m, along_m)[:, None]
    on_m = np.clip(share, 0.0, 1.0)[:, :, None] * along_m[:, None]
    return np.asarray(np.linalg.norm(from_m - on_m, axis=-1))

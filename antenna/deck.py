"""NEC decks, the text files that nec2c, xnec2c and 4nec2 read: written of arrays, read for an element.

Understood when read: CM, CE, GW, GM, GS, GE, EX 0, EN; what only asks for results (FR, RP, XQ, PT, PQ, NE,
NH) is passed over. Anything else changes the antenna in ways that are not modelled here, and is refused by
its line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from antenna.clearance import placed_wires_m
from antenna.elements import Element, Wire
from antenna.geometry import Snapshot

SPEED_OF_LIGHT_M_S = 299_792_458.0
_PASSED_OVER = {"CM", "CE", "FR", "RP", "XQ", "PT", "PQ", "NE", "NH", "EN"}
_INTEGERS = {"GW": 2, "GM": 2, "GS": 2, "EX": 4, "GE": 1}
_MOST_WIRES = 1_000


class DeckError(ValueError):
    """A deck that cannot be read; the text is one line with the deck's line number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """What a deck's GN card says; ``permittivity`` None is a perfect conductor."""

    permittivity: float | None = None
    conductivity_s_m: float = 0.0


def read_element(text: str) -> Element:
    """Read a deck's wires and its source, of which there is one; raises DeckError."""
    wires: list[tuple[int, Wire]] = []
    source: tuple[int, int] | None = None
    number = 0
    for number, line in enumerate(text.splitlines(), start=1):
        card, fields = line[:2].upper(), line[2:]
        if not line.strip() or card in _PASSED_OVER:
            continue
        try:
            integers, reals = _fields(card, fields)
            match card:
                case "GW":
                    wires.append(_wire(integers, reals))
                case "GS":
                    wires = [(tag, _scaled(wire, reals[0])) for tag, wire in wires]
                case "GM":
                    wires = _moved(wires, integers, reals)
                case "GE":
                    if integers[0] != 0:
                        raise ValueError("an element has no ground of its own: expected GE 0")  # noqa: TRY301  # one place that adds the line
                case "EX":
                    if source is not None:
                        raise ValueError("a second source; an element has one")  # noqa: TRY301
                    if integers[0] != 0:
                        raise ValueError(f"source of kind {integers[0]}; expected 0, a voltage")  # noqa: TRY301
                    source = integers[1], integers[2]
                case _:
                    raise ValueError(f"card {card!r} is not understood")  # noqa: TRY301
        except ValueError as error:
            raise DeckError(f"line {number}: {error}") from None
        if len(wires) > _MOST_WIRES:
            raise DeckError(f"line {number}: more than {_MOST_WIRES} wires")
    if not wires:
        raise DeckError(f"line {number}: the deck has no wires")
    if source is None:
        raise DeckError(f"line {number}: the deck has no source (EX 0)")
    try:
        return Element(wires=tuple(wire for _, wire in wires), feed_segment=_segment(wires, *source))
    except ValueError as error:
        raise DeckError(f"line {number}: {error}") from None


def write_deck(
    snapshot: Snapshot,
    element: Element,
    wavelength_m: float,
    *,
    ground: Ground | None = None,
    step_deg: float = 5.0,
    comments: Sequence[str] = (),
) -> str:
    """Write the deck of an array at one instant; it asks for the gain on a grid of the whole sphere.

    Element k has the tags k W + 1 to (k + 1) W, W being its number of wires.
    """  # fmt: skip
    cards = [f"CM {comment}" for comment in comments] + ["CE"]
    for k, wires in enumerate(placed_wires_m(snapshot, element)):
        for w, (wire, ends_m) in enumerate(zip(element.wires, wires, strict=True)):
            numbers = (*ends_m[0].tolist(), *ends_m[1].tolist(), wire.radius_m)
            tag = k * len(element.wires) + w + 1
            cards.append(f"GW {tag} {wire.segments} " + " ".join(f"{value:.9g}" for value in numbers))
    cards.append(f"GE {0 if ground is None else 1}")
    if ground is not None and ground.permittivity is None:
        cards.append("GN 1")
    elif ground is not None:
        cards.append(f"GN 2 0 0 0 {ground.permittivity:.9g} {ground.conductivity_s_m:.9g}")
    cards.append(f"FR 0 1 0 0 {SPEED_OF_LIGHT_M_S / wavelength_m / 1e6:.12g} 0")
    fed, segment = feed(element)
    for k, voltage in enumerate(snapshot.voltages.tolist()):
        if voltage != 0.0:  # NEC2 takes a source of 0 V for one of 1 V
            tag = k * len(element.wires) + fed + 1
            cards.append(f"EX 0 {tag} {segment + 1} 0 {voltage.real:.9g} {voltage.imag:.9g}")
    rows = math.ceil(180.0 / step_deg - 1e-9)
    step = 180.0 / rows
    rows_seen = rows + 1 if ground is None else rows // 2 + 1
    cards += [f"RP 0 {rows_seen} {2 * rows} 1000 0 0 {step:.9g} {step:.9g} 0 0", "EN"]
    return "\n".join(cards) + "\n"


def feed(element: Element) -> tuple[int, int]:
    """Wire and segment of it, both from 0, at which an element is fed."""
    segment = element.feed_segment
    for number, wire in enumerate(element.wires):
        if segment < wire.segments:
            return number, segment
        segment -= wire.segments
    raise AssertionError("an element is fed at one of its segments")


def _fields(card: str, text: str) -> tuple[list[int], list[float]]:
    """Integers and reals of a card, missing ones being 0."""
    words = text.replace(",", " ").split()
    count = _INTEGERS.get(card, 0)
    try:
        integers = [int(float(word)) for word in words[:count]]
        reals = [float(word) for word in words[count:]]
    except (ValueError, OverflowError):
        raise ValueError(f"{card}: expected numbers, not {text.strip()[:40]!r}") from None
    if not all(math.isfinite(value) for value in reals):
        raise ValueError(f"{card}: expected finite numbers")
    return integers + [0] * (count - len(integers)), reals + [0.0] * (7 - len(reals))


def _wire(integers: list[int], reals: list[float]) -> tuple[int, Wire]:
    tag, segments = integers
    if not 1 <= segments <= 1_000:
        raise ValueError(f"GW: {segments} segments; expected 1 to 1000")
    if reals[6] <= 0.0:
        raise ValueError("GW: expected a radius above 0 (tapered wires, GC, are not understood)")
    start, end = (reals[0], reals[1], reals[2]), (reals[3], reals[4], reals[5])
    if start == end:
        raise ValueError("GW: a wire without length")
    return tag, Wire(start_m=start, end_m=end, radius_m=reals[6], segments=segments)


def _scaled(wire: Wire, factor: float) -> Wire:
    if factor <= 0.0:
        raise ValueError(f"GS: expected a factor above 0, not {factor:g}")
    (a, b, c), (d, e, f) = wire.start_m, wire.end_m
    return Wire(
        start_m=(a * factor, b * factor, c * factor), end_m=(d * factor, e * factor, f * factor),
        radius_m=wire.radius_m * factor, segments=wire.segments,
    )  # fmt: skip


def _moved(wires: list[tuple[int, Wire]], integers: list[int], reals: list[float]) -> list[tuple[int, Wire]]:
    """GM: turn about x, then y, then z, and move; all wires themselves, or that many copies."""
    increment, copies = integers
    if not 0 <= copies <= _MOST_WIRES:
        raise ValueError(f"GM: {copies} copies")
    if reals[6]:
        raise ValueError("GM: moving wires from a tag on is not understood; expected 0, all of them")
    a, b, c = (math.radians(angle) for angle in reals[:3])
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    turn, shift = about_z @ about_y @ about_x, np.array(reals[3:6])

    def move(entry: tuple[int, Wire]) -> tuple[int, Wire]:
        tag, wire = entry
        start, end = (tuple((turn @ np.array(p) + shift).tolist()) for p in (wire.start_m, wire.end_m))
        return tag + increment if tag else 0, replace(wire, start_m=start, end_m=end)

    if copies == 0:
        return [move(entry) for entry in wires]
    last, found = wires, list(wires)
    for _ in range(copies):
        last = [move(entry) for entry in last]
        found += last
        if len(found) > _MOST_WIRES:
            break
    return found


def _segment(wires: list[tuple[int, Wire]], tag: int, number: int) -> int:
    """Index over all wires of the ``number``-th segment, from 1, of those with a tag; tag 0 is all."""
    first, left = 0, number
    for own, wire in wires:
        if tag in (0, own):
            if 1 <= left <= wire.segments:
                return first + left - 1
            left -= wire.segments
        first += wire.segments
    raise ValueError(f"EX: there is no segment {number} of tag {tag}")

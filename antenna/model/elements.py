"""Antenna elements: straight wires on a vehicle, and their feed point.

The frame of an element has its origin at the vehicle and z up when the vehicle is upright.
"""

import math
from dataclasses import dataclass

WIRE_LENGTH_M = 1e-6, 1_000.0
"""Least and greatest length of a wire and of an element."""
WIRE_RADIUS_M = 1e-9, 10.0
THIN_WIRE_SLENDERNESS = 8.0
"""Least ratio of segment length to wire radius for errors below 1 % (NEC-2 User's Guide, wire modelling)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """A straight wire, divided into equal segments."""

    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    radius_m: float
    segments: int

    @property
    def length_m(self) -> float:
        """Distance between its ends."""
        return math.dist(self.start_m, self.end_m)

    @property
    def slenderness(self) -> float:
        """Length of a segment in radii of the wire."""
        return self.length_m / self.segments / self.radius_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """Wires of one vehicle, fed by one source; coincident ends are connected."""

    wires: tuple[Wire, ...]
    feed_segment: int
    """Segment of the voltage source, counted from 0 over all wires; positive along its wire."""


def dipole(length_m: float, radius_m: float, segments: int) -> Element:
    """Return a vertical dipole centred at the origin, fed in the middle; ``segments`` is odd."""
    half_m = 0.5 * length_m
    wire = Wire(start_m=(0.0, 0.0, -half_m), end_m=(0.0, 0.0, half_m), radius_m=radius_m, segments=segments)
    return Element(wires=(wire,), feed_segment=segments // 2)


def loop(radius_m: float, wire_radius_m: float, sides: int) -> Element:
    """Return a level loop about the origin: a polygon of one-segment wires, fed at the one towards +x."""
    corners = [2.0 * math.pi * (k - 0.5) / sides for k in range(sides)]
    corners_m = [(radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0) for angle in corners]
    wires = tuple(
        Wire(start_m=corners_m[k], end_m=corners_m[(k + 1) % sides], radius_m=wire_radius_m, segments=1)
        for k in range(sides)
    )
    return Element(wires=wires, feed_segment=0)

"""Settings of the synthetic aperture: what a scenario's ``[antenna]`` table may say."""

import math
from functools import lru_cache
from typing import Annotated, Literal

from msgspec import Meta, Struct

from antenna.model.deck import read_element
from antenna.model.elements import THIN_WIRE_SLENDERNESS, WIRE_LENGTH_M, WIRE_RADIUS_M, Element, dipole, loop


class AntennaConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Elements, their feeds and how patterns are computed."""

    wavelength_m: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 10.0
    """Wavelength at which the array works, metres."""
    element_kind: Literal["dipole", "loop", "deck"] = "dipole"
    """A dipole along the vehicle's vertical axis, a level loop about it, or the wires of a NEC deck."""
    element_length_m: Annotated[float, Meta(ge=WIRE_LENGTH_M[0], le=WIRE_LENGTH_M[1])] = 0.05
    """Of the dipole, electrically small, as a size-limited antenna is; of a loop its circumference."""
    element_radius_m: Annotated[float, Meta(ge=WIRE_RADIUS_M[0], le=WIRE_RADIUS_M[1])] = 0.0002
    """Of the wire."""
    segments: Annotated[int, Meta(ge=3, le=199)] = 9
    """Thin-wire segments of a dipole or loop; a dipole's are odd, so that the source sits in the middle."""
    element_deck: str = ""
    """A NEC deck's text: what ``element_file`` says, or said here instead."""
    element_file: str = ""
    """NEC deck beside the scenario, for the kind deck."""
    excitation: Literal["end_fire", "hansen_woodyard", "optimum"] = "end_fire"
    """Feeds of the elements: progressive phases of ordinary end fire or of Hansen and Woodyard, or the
    feeds of greatest gain along +y."""
    feeds_for: Literal["places", "estimates", "truth"] = "places"
    """Positions that the feeds are made for: the formation's places, where the vehicles believe themselves to
    be, or where they are."""
    ground: Literal["none", "perfect", "real"] = "none"
    """Level, at height 0 of the site."""
    ground_permittivity: Annotated[float, Meta(ge=1.0, le=100.0)] = 13.0
    """Relative permittivity of a real ground."""
    ground_conductivity_s_m: Annotated[float, Meta(ge=0.0, le=1e8)] = 0.005
    """Of a real ground; average land (ITU-R P.527)."""
    backend: Literal["batch", "nec2", "nec2c"] = "batch"
    """Solver of the currents: the batch solver of this project, NEC2 (PyNEC) or the program nec2c."""
    snapshot_rate_hz: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 2.0
    """Instants of the flight, per simulated second, for which a pattern is computed."""
    grid_deg: Annotated[float, Meta(ge=0.1, le=30.0)] = 5.0
    """Step of the pattern in theta and phi; the maximum is refined beyond it."""
    keep_patterns: bool = False
    """Write a flight's patterns to patterns.nc."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.element_kind == "deck":
            if not self.element_deck.strip():
                raise ValueError("element_file: the kind deck needs one; expected a NEC deck's file")
            self.element()
        elif self.element_file or self.element_deck:
            named = "element_file" if self.element_file else "element_deck"
            raise ValueError(f"{named}: a {self.element_kind} has none; expected element_kind deck")
        else:
            if self.element_kind == "dipole" and self.segments % 2 == 0:
                raise ValueError(
                    f"segments: {self.segments} is even; a source in the middle needs an odd number"
                )
            slenderness = self.element().wires[0].slenderness
            if slenderness < THIN_WIRE_SLENDERNESS:
                raise ValueError(
                    f"element_radius_m: a segment is {slenderness:.1f} radii long;"
                    f" the thin-wire kernel needs {THIN_WIRE_SLENDERNESS:g}"
                    " (fewer segments or a thinner wire)"
                )
        if self.ground == "real" and self.backend == "batch":
            raise ValueError("backend: batch knows no real ground; expected nec2 or nec2c")
        if self.ground == "real" and self.excitation == "optimum":
            raise ValueError(
                "excitation: the batch solver finds the optimum, and knows no real ground;"
                " expected end_fire or hansen_woodyard"
            )

    def element(self) -> Element:
        """Wires of one element; raises DeckError."""
        match self.element_kind:
            case "dipole":
                return dipole(self.element_length_m, self.element_radius_m, self.segments)
            case "loop":
                return loop(self.element_length_m / (2.0 * math.pi), self.element_radius_m, self.segments)
            case "deck":
                return _element_of(self.element_deck)


@lru_cache(maxsize=8)
def _element_of(deck: str) -> Element:
    return read_element(deck)

"""Settings of the synthetic aperture: the fields of a scenario's ``[antenna]`` table."""

import math
from functools import lru_cache
from typing import Annotated, Literal

from msgspec import Meta, Struct

from antenna.model.deck import read_element
from antenna.model.elements import THIN_WIRE_SLENDERNESS, WIRE_LENGTH_M, WIRE_RADIUS_M, Element, dipole, loop


class AntennaConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the elements, their feeds and the computation of patterns."""

    wavelength_m: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 10.0
    """Wavelength at which the array works, metres."""
    element_kind: Literal["dipole", "loop", "deck"] = "dipole"
    """``dipole`` along the vehicle's vertical axis, level ``loop`` about it, or wires of a NEC ``deck``."""
    element_length_m: Annotated[float, Meta(ge=WIRE_LENGTH_M[0], le=WIRE_LENGTH_M[1])] = 0.05
    """Length of the dipole, by default electrically small, or circumference of the loop."""
    element_radius_m: Annotated[float, Meta(ge=WIRE_RADIUS_M[0], le=WIRE_RADIUS_M[1])] = 0.0002
    """Wire radius."""
    segments: Annotated[int, Meta(ge=3, le=199)] = 9
    """Thin-wire segments of a dipole or loop; odd for a dipole, so that the source is in the middle."""
    element_deck: str = ""
    """Text of a NEC deck, the content of ``element_file`` or given directly."""
    element_file: str = ""
    """Path of the NEC deck relative to the scenario, for ``element_kind`` deck."""
    excitation: Literal["end_fire", "hansen_woodyard", "optimum"] = "end_fire"
    """Feeds of the elements: progressive phases of ordinary end fire or of Hansen and Woodyard, or the
    feeds of greatest gain along +y."""
    feeds_for: Literal["places", "estimates", "truth"] = "places"
    """Positions used for the feeds: ``places`` of the formation, ``estimates`` of the vehicles, or true
    positions."""
    ground: Literal["none", "perfect", "real"] = "none"
    """Kind of ground, level at height 0 of the site; ``none``: free space."""
    ground_permittivity: Annotated[float, Meta(ge=1.0, le=100.0)] = 13.0
    """Relative permittivity of a real ground."""
    ground_conductivity_s_m: Annotated[float, Meta(ge=0.0, le=1e8)] = 0.005
    """Conductivity of a real ground; the defaults of both are average land (ITU-R P.527)."""
    backend: Literal["batch", "nec2", "nec2c"] = "batch"
    """Solver of the currents: the batch solver of this project, NEC2 (PyNEC) or the program nec2c."""
    snapshot_rate_hz: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 2.0
    """Patterns computed per simulated second of the flight."""
    grid_deg: Annotated[float, Meta(ge=0.1, le=30.0)] = 5.0
    """Step of the pattern in theta and phi; the maximum is refined between grid directions."""
    keep_patterns: bool = False
    """Write a flight's patterns to patterns.nc."""

    def __post_init__(self) -> None:
        """Check that the fields are consistent."""
        if self.element_kind == "deck":
            if not self.element_deck.strip():
                raise ValueError("element_file: element_kind deck requires a NEC deck file")
            self.element()
        elif self.element_file or self.element_deck:
            named = "element_file" if self.element_file else "element_deck"
            raise ValueError(f"{named}: only for element_kind deck, not {self.element_kind}")
        else:
            if self.element_kind == "dipole" and self.segments % 2 == 0:
                raise ValueError(
                    f"segments: {self.segments} is even; a source in the middle requires an odd number"
                )
            slenderness = self.element().wires[0].slenderness
            if slenderness < THIN_WIRE_SLENDERNESS:
                raise ValueError(
                    f"element_radius_m: a segment is {slenderness:.1f} radii long; the thin-wire kernel needs"
                    f" {THIN_WIRE_SLENDERNESS:g} (fewer segments or a thinner wire)"
                )
        if self.ground == "real" and self.backend == "batch":
            raise ValueError("backend: batch does not support real ground; expected nec2 or nec2c")
        if self.ground == "real" and self.excitation == "optimum":
            raise ValueError(
                "excitation: optimum is computed by the batch solver, which does not support real ground;"
                " expected end_fire or hansen_woodyard"
            )

    def element(self) -> Element:
        """Return the wires of one element; raises DeckError."""
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

"""Settings of the synthetic aperture: what a scenario's ``[antenna]`` table may say."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

THIN_WIRE_SLENDERNESS = 8.0
"""Least segment length over wire radius for errors under 1 % (NEC-2 User's Guide, wire modelling)."""


class AntennaConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Elements, their feeds and how patterns are computed."""

    wavelength_m: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 10.0
    element_length_m: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 0.05
    """Vertical dipole on each vehicle: electrically small, as a size-limited antenna is."""
    element_radius_m: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.0002
    segments: Annotated[int, Meta(ge=3, le=99)] = 9
    """Thin-wire segments of a dipole; odd, so that the source sits in the middle."""
    backend: Literal["nec2"] = "nec2"
    snapshot_rate_hz: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 2.0
    """Instants of the flight, per simulated second, for which a pattern is computed."""
    grid_deg: Annotated[float, Meta(gt=0.0, le=30.0)] = 5.0
    """Step of the pattern in theta and phi; the maximum is refined beyond it."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.segments % 2 == 0:
            raise ValueError(f"segments: {self.segments} is even; a source in the middle needs an odd number")
        slenderness = self.element_length_m / self.segments / self.element_radius_m
        if slenderness < THIN_WIRE_SLENDERNESS:
            raise ValueError(
                f"element_radius_m: a segment is {slenderness:.1f} radii long;"
                f" the thin-wire kernel needs {THIN_WIRE_SLENDERNESS:g} (fewer segments or a thinner wire)"
            )

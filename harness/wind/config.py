"""The scenario's ``[wind]`` table."""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct

from autopilot.types import Array

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Direction = Annotated[float, Meta(ge=-360.0, le=360.0)]
VerticalFraction = Annotated[float, Meta(ge=-1.0, le=1.0)]
LEAST_SCALE_HEIGHT_M = 3.048
MOST_SCALE_HEIGHT_M = 304.8
"""10 and 1000 feet: between them MIL-F-8785C's low-altitude model holds."""


class GustConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of the scenario's ``[[wind.gusts]]``: known beforehand, alike for all, on top of the rest."""

    shape: Literal["one_minus_cosine", "step", "ramp"]
    """How it rises over ``rise_s``. With a ``duration_s`` of twice that "one_minus_cosine" is the pulse of
    airworthiness codes (CS-25.341), without one MIL-F-8785C's discrete gust, which stays."""
    start_s: NonNegative
    """Simulated time from the run's start."""
    rise_s: NonNegative = 0.0
    """From nothing to the peak; 0 for a step alone."""
    duration_s: Positive | None = None
    """From its start to its end; it falls as it rose. Without it the peak stays."""
    peak_n: float | None = None
    """Force, where the wind's ``kind`` is "force"; below 0 it points the other way."""
    peak_m_s: float | None = None
    """Velocity of the air, where the wind's ``kind`` is "velocity"."""
    direction_deg: Direction | None = None
    """Where it points to, clockwise from north; without it as the wind does."""
    vertical_fraction: VerticalFraction = 0.0
    """Down component over the magnitude."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.shape == "step" and self.rise_s != 0.0:
            raise ValueError('rise_s: a gust of shape "step" has none')
        if self.shape != "step" and self.rise_s == 0.0:
            raise ValueError(f'rise_s: a gust of shape "{self.shape}" takes time to rise')
        if self.duration_s is not None and self.duration_s < 2.0 * self.rise_s:
            raise ValueError(f"duration_s: {self.duration_s:g} s is too short to rise and fall")


class WindConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[wind]`` table.

    Of ``kind`` "force" it is a force on every vehicle, whatever its motion; of kind "velocity" the air moves,
    and what that does is the aerodynamics' matter (`harness.physics.rotors`).
    """

    kind: Literal["force", "velocity"] = "force"
    direction_deg: Direction = 45.0
    """Where the force points or the air moves to, clockwise from north."""
    vertical_fraction: VerticalFraction = 0.0
    """Down component of the mean over its magnitude."""
    correlation: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.8
    """Of gusts or turbulence at any two vehicles, however far apart."""
    gusts: tuple[GustConfig, ...] = ()

    mean_n: Annotated[float, Meta(ge=0.0, le=100.0)] = 5.0
    """Magnitude of the mean force; this and the next two are for kind "force"."""
    gust_rms_fraction: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.2
    """rms of each horizontal component of the gusts over the mean's magnitude."""
    gust_time_constant_s: Annotated[float, Meta(gt=0.0)] = 2.0

    mean_m_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 5.0
    """Mean speed of the air, at ``reference_height_m`` if it grows with height; this and all that follows is
    for kind "velocity"."""
    profile: Literal["uniform", "logarithmic"] = "uniform"
    """How the mean depends on height above the ground: not, or as ln(h / roughness length)."""
    reference_height_m: Positive = 10.0
    roughness_length_m: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.03
    """0.03 m is open flat country with grass, 0.5 m are bushes, 1 m suburbs (WMO's classification)."""
    turbulence: Literal["none", "dryden", "von_karman"] = "none"
    """Spectrum of the turbulence; its strength and lengths are those of MIL-F-8785C's low-altitude model."""
    wind_20ft_m_s: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    """Mean speed 20 feet above the ground, which says how strong the turbulence is; without it the mean's
    there."""
    turbulence_height_m: Annotated[float, Meta(ge=LEAST_SCALE_HEIGHT_M, le=MOST_SCALE_HEIGHT_M)] = 10.0
    """Height above the ground whose scale lengths and strengths hold, for all vehicles and all the time."""
    least_passing_speed_m_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 2.0
    """Turbulence is a frozen pattern that the mean wind carries past vehicles that hover; at least this
    fast."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        other = FORCE_FIELDS if self.kind == "velocity" else VELOCITY_FIELDS
        for name in other:
            if getattr(self, name) != _DEFAULTS[name]:
                raise ValueError(f'{name}: has no effect where kind is "{self.kind}"')
        if self.profile == "logarithmic" and self.reference_height_m <= self.roughness_length_m:
            raise ValueError("reference_height_m: expected more than roughness_length_m")
        wanted, unwanted = ("peak_n", "peak_m_s") if self.kind == "force" else ("peak_m_s", "peak_n")
        for number, gust in enumerate(self.gusts):
            if getattr(gust, wanted) is None or getattr(gust, unwanted) is not None:
                raise ValueError(
                    f'gusts[{number}]: expected {wanted}, and not {unwanted}, as kind is "{self.kind}"'
                )

    def mean_speed_m_s(self, height_m: Array) -> Array:
        """Magnitude of the mean velocity at heights above the ground, of any shape."""
        if self.profile == "uniform":
            return np.full_like(height_m, self.mean_m_s)
        z0_m = self.roughness_length_m
        growth = np.log(np.maximum(height_m, z0_m) / z0_m) / math.log(self.reference_height_m / z0_m)
        return np.asarray(self.mean_m_s * growth)


FORCE_FIELDS = ("mean_n", "gust_rms_fraction", "gust_time_constant_s")
VELOCITY_FIELDS = (
    "mean_m_s",
    "profile",
    "reference_height_m",
    "roughness_length_m",
    "turbulence",
    "wind_20ft_m_s",
    "turbulence_height_m",
    "least_passing_speed_m_s",
)
_DEFAULTS = dict(
    zip(
        WindConfig.__struct_fields__[-len(WindConfig.__struct_defaults__) :],
        WindConfig.__struct_defaults__,
        strict=True,
    )
)


def direction_ned(direction_deg: float, vertical_fraction: float) -> Array:
    """Unit vector (3,) NED of a compass direction and a down component."""
    direction_rad = math.radians(direction_deg)
    horizontal = math.sqrt(1.0 - vertical_fraction**2)
    return np.array(
        [horizontal * math.cos(direction_rad), horizontal * math.sin(direction_rad), vertical_fraction]
    )

"""The scenario's ``[wind]`` table."""

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from foundation.types import Array

Direction = Annotated[float, Meta(ge=-360.0, le=360.0)]
VerticalFraction = Annotated[float, Meta(ge=-1.0, le=1.0)]
Speed = Annotated[float, Meta(ge=0.0, le=60.0)]
MOST_SPEED_M_S = 60.0
"""Of the mean wind at any height: a hurricane's, in which nothing flies."""
MOST_TIME_S = 1e6
LEAST_SCALE_HEIGHT_M = 3.048
MOST_SCALE_HEIGHT_M = 304.8
"""10 and 1000 feet: between them MIL-F-8785C's low-altitude model holds."""


class GustConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of the scenario's ``[[wind.gusts]]``: known beforehand, alike for all, on top of the rest."""

    shape: Literal["one_minus_cosine", "step", "ramp"]
    """How it rises over ``rise_s``. With a ``duration_s`` of twice that "one_minus_cosine" is the pulse of
    airworthiness codes (CS-25.341), without one MIL-F-8785C's discrete gust, which stays."""
    start_s: Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)]
    """Simulated time from the run's start."""
    rise_s: Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)] = 0.0
    """From nothing to the peak; 0 for a step alone."""
    duration_s: Annotated[float, Meta(ge=0.004, le=MOST_TIME_S)] | None = None
    """From its start to its end, at least a step; it falls as it rose. Without it the peak stays."""
    peak_n: Annotated[float, Meta(ge=-100.0, le=100.0)] | None = None
    """Force, where the wind's ``kind`` is "force"; below 0 it points the other way."""
    peak_m_s: Annotated[float, Meta(ge=-60.0, le=60.0)] | None = None
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceModel:
    """Fields of `WindConfig` that matter where ``kind`` is "force", all of them set."""

    mean_n: float = 5.0
    gust_rms_fraction: float = 0.2
    gust_time_constant_s: float = 2.0
    correlation: float = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityModel:
    """Fields of `WindConfig` that matter where ``kind`` is "velocity", all of them set."""

    mean_m_s: float = 5.0
    profile: Literal["uniform", "logarithmic"] = "uniform"
    reference_height_m: float = 10.0
    roughness_length_m: float = 0.03
    turbulence: Literal["none", "dryden", "von_karman"] = "none"
    wind_20ft_m_s: float | None = None
    """None: the mean's there"""
    turbulence_height_m: float
    least_passing_speed_m_s: float = 2.0
    correlation: float = 0.8

    def mean_speed_m_s(self, height_m: Array) -> Array:
        """Magnitude of the mean velocity at heights above the ground, of any shape."""
        if self.profile == "uniform":
            return np.full_like(height_m, self.mean_m_s)
        z0_m = self.roughness_length_m
        growth = np.log(np.maximum(height_m, z0_m) / z0_m) / math.log(self.reference_height_m / z0_m)
        return np.asarray(np.minimum(self.mean_m_s * growth, MOST_SPEED_M_S))


class WindConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[wind]`` table.

    Of ``kind`` "force" it is a force on every vehicle, whatever its motion; of kind "velocity" the air moves,
    and what that does is the aerodynamics' matter (`harness.world.physics.rotors`). None is the value in
    `ForceModel` or `VelocityModel`; what is said but has no effect is refused.
    """

    kind: Literal["force", "velocity"] = "force"
    """Whether the wind acts as a force or moves the air."""
    direction_deg: Direction = 45.0
    """Where the force points or the air moves to, clockwise from north."""
    vertical_fraction: VerticalFraction = 0.0
    """Down component of the mean over its magnitude."""
    correlation: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Of gusts or turbulence at any two vehicles, however far apart."""
    gusts: tuple[GustConfig, ...] = ()
    """Discrete gusts: tables ``[[wind.gusts]]``."""

    mean_n: Annotated[float, Meta(ge=0.0, le=100.0)] | None = None
    """Magnitude of the mean force; this and the next two are for kind "force"."""
    gust_rms_fraction: Annotated[float, Meta(ge=0.0, le=5.0)] | None = None
    """rms of each horizontal component of the gusts over the mean's magnitude."""
    gust_time_constant_s: Annotated[float, Meta(gt=0.0, le=MOST_TIME_S)] | None = None
    """Correlation time of the gusts, seconds."""

    mean_m_s: Speed | None = None
    """Mean speed of the air, at ``reference_height_m`` if it grows with height; this and all that follows is
    for kind "velocity"."""
    profile: Literal["uniform", "logarithmic"] | None = None
    """How the mean depends on height above the ground: not, or as ln(h / roughness length), up to
    `MOST_SPEED_M_S`."""
    reference_height_m: Annotated[float, Meta(ge=0.1, le=500.0)] | None = None
    """At least ten roughness lengths; this and the next are for profile "logarithmic"."""
    roughness_length_m: Annotated[float, Meta(ge=1e-6, le=5.0)] | None = None
    """0.03 m is open flat country with grass, 0.5 m are bushes, 1 m suburbs (WMO's classification)."""
    turbulence: Literal["none", "dryden", "von_karman"] | None = None
    """Spectrum of the turbulence; its strength and lengths are those of MIL-F-8785C's low-altitude model. The
    rest is for other than "none"."""
    wind_20ft_m_s: Speed | None = None
    """Mean speed 20 feet above the ground, which says how strong the turbulence is; without it the mean's
    there."""
    turbulence_height_m: Annotated[float, Meta(ge=LEAST_SCALE_HEIGHT_M, le=MOST_SCALE_HEIGHT_M)] | None = None
    """Height above the ground whose scale lengths and strengths hold, for all vehicles and all the time;
    without it the formation's, or what of these bounds is nearest to that."""
    least_passing_speed_m_s: Annotated[float, Meta(ge=0.01, le=60.0)] | None = None
    """Turbulence is a frozen pattern that the mean wind carries past vehicles that hover; at least this
    fast."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        idle = "; ".join(
            f"{', '.join(names)}: no effect where {where}" for where, names in self._idle_fields().items()
        )
        if idle:
            raise ValueError(idle)
        if self.profile == "logarithmic":
            model = self.velocity_model(MOST_SCALE_HEIGHT_M)
            if model.reference_height_m < LEAST_REFERENCE_ROUGHNESSES * model.roughness_length_m:
                raise ValueError(
                    f"reference_height_m: expected at least {LEAST_REFERENCE_ROUGHNESSES:g} times "
                    f"roughness_length_m, {model.roughness_length_m:g} m"
                )
        wanted, unwanted = ("peak_n", "peak_m_s") if self.kind == "force" else ("peak_m_s", "peak_n")
        for number, gust in enumerate(self.gusts):
            if getattr(gust, wanted) is None or getattr(gust, unwanted) is not None:
                raise ValueError(
                    f'gusts[{number}]: expected {wanted}, and not {unwanted}, as kind is "{self.kind}"'
                )

    def force_model(self) -> ForceModel:
        """Give what is for kind "force", with the usual values where nothing is said."""
        return ForceModel(**self._said(ForceModel))

    def velocity_model(self, formation_height_m: float) -> VelocityModel:
        """Give what is for kind "velocity", with the usual values where nothing is said."""
        nearest_m = min(max(formation_height_m, LEAST_SCALE_HEIGHT_M), MOST_SCALE_HEIGHT_M)
        return VelocityModel(**{"turbulence_height_m": nearest_m, **self._said(VelocityModel)})

    def _said(self, model: type[ForceModel | VelocityModel]) -> dict[str, Any]:
        values = {each.name: getattr(self, each.name) for each in fields(model)}
        return {name: value for name, value in values.items() if value is not None}

    def _idle_fields(self) -> dict[str, list[str]]:
        """Fields that are said and have no effect, by the reason."""
        idle: dict[str, tuple[str, ...]] = {}
        if self.kind == "force":
            idle['kind is "force"'] = _VELOCITY_FIELDS
        else:
            idle['kind is "velocity"'] = _FORCE_FIELDS
            if self.profile != "logarithmic":
                idle['profile is "uniform"'] = _PROFILE_FIELDS
            if self.turbulence is None or self.turbulence == "none":
                idle['turbulence is "none"'] = ("correlation", *_TURBULENCE_FIELDS)
        said = {
            where: [name for name in names if getattr(self, name) is not None]
            for where, names in idle.items()
        }
        return {where: names for where, names in said.items() if names}


LEAST_REFERENCE_ROUGHNESSES = 10.0
_FORCE_FIELDS = ("mean_n", "gust_rms_fraction", "gust_time_constant_s")
_PROFILE_FIELDS = ("reference_height_m", "roughness_length_m")
_TURBULENCE_FIELDS = ("wind_20ft_m_s", "turbulence_height_m", "least_passing_speed_m_s")
_VELOCITY_FIELDS = ("mean_m_s", "profile", *_PROFILE_FIELDS, "turbulence", *_TURBULENCE_FIELDS)


def direction_ned(direction_deg: float, vertical_fraction: float) -> Array:
    """Unit vector (3,) NED of a compass direction and a down component."""
    direction_rad = math.radians(direction_deg)
    horizontal = math.sqrt(1.0 - vertical_fraction**2)
    return np.array(
        [horizontal * math.cos(direction_rad), horizontal * math.sin(direction_rad), vertical_fraction]
    )

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
"""Limit of the mean wind at any height: hurricane strength."""
MOST_TIME_S = 1e6
LEAST_SCALE_HEIGHT_M = 3.048
MOST_SCALE_HEIGHT_M = 304.8
"""10 and 1000 feet: range of MIL-F-8785C's low-altitude model."""


class GustConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of the scenario's ``[[wind.gusts]]``: deterministic, equal for all vehicles, added to the wind."""

    shape: Literal["one_minus_cosine", "step", "ramp"]
    """Shape of the rise over ``rise_s``. With a ``duration_s`` of twice that, "one_minus_cosine" is the pulse
    of airworthiness codes (CS-25.341); without, it is MIL-F-8785C's discrete gust, which lasts."""
    start_s: Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)]
    """Simulated time since the run's start."""
    rise_s: Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)] = 0.0
    """Time from zero to the peak; 0 for "step" only."""
    duration_s: Annotated[float, Meta(ge=0.004, le=MOST_TIME_S)] | None = None
    """Time from start to end, at least one step; the fall mirrors the rise. None: the peak lasts."""
    peak_n: Annotated[float, Meta(ge=-100.0, le=100.0)] | None = None
    """Peak force if the wind's ``kind`` is "force"; negative for the opposite direction."""
    peak_m_s: Annotated[float, Meta(ge=-60.0, le=60.0)] | None = None
    """Peak velocity of the air if the wind's ``kind`` is "velocity"."""
    direction_deg: Direction | None = None
    """Direction that it points to, clockwise from north; None: that of the wind."""
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
    """Fields of `WindConfig` for ``kind`` "force", all with values."""

    mean_n: float = 5.0
    gust_rms_fraction: float = 0.2
    gust_time_constant_s: float = 2.0
    correlation: float = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityModel:
    """Fields of `WindConfig` for ``kind`` "velocity", all with values."""

    mean_m_s: float = 5.0
    profile: Literal["uniform", "logarithmic"] = "uniform"
    reference_height_m: float = 10.0
    roughness_length_m: float = 0.03
    turbulence: Literal["none", "dryden", "von_karman"] = "none"
    wind_20ft_m_s: float | None = None
    """None: the mean wind at that height"""
    turbulence_height_m: float
    least_passing_speed_m_s: float = 2.0
    correlation: float = 0.8

    def mean_speed_m_s(self, height_m: Array) -> Array:
        """Return the mean speed at heights above the ground, an array of any shape."""
        if self.profile == "uniform":
            return np.full_like(height_m, self.mean_m_s)
        z0_m = self.roughness_length_m
        growth = np.log(np.maximum(height_m, z0_m) / z0_m) / math.log(self.reference_height_m / z0_m)
        return np.asarray(np.minimum(self.mean_m_s * growth, MOST_SPEED_M_S))


class WindConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[wind]`` table.

    With ``kind`` "force" it is a force on every vehicle, independent of its motion; with "velocity" the air
    moves, and `harness.world.physics.rotors` computes the forces. None: the default in `ForceModel` or
    `VelocityModel`. Fields that have a value but no effect are refused.
    """

    kind: Literal["force", "velocity"] = "force"
    """Whether the wind acts as a force or moves the air."""
    direction_deg: Direction = 45.0
    """Direction of the force or of the air's motion, clockwise from north."""
    vertical_fraction: VerticalFraction = 0.0
    """Down component of the mean over its magnitude."""
    correlation: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Correlation of gusts or turbulence at any two vehicles, independent of their distance."""
    gusts: tuple[GustConfig, ...] = ()
    """Discrete gusts: tables ``[[wind.gusts]]``."""

    mean_n: Annotated[float, Meta(ge=0.0, le=100.0)] | None = None
    """Magnitude of the mean force, for kind "force"."""
    gust_rms_fraction: Annotated[float, Meta(ge=0.0, le=5.0)] | None = None
    """RMS of each horizontal component of the gusts over the mean's magnitude, for kind "force"."""
    gust_time_constant_s: Annotated[float, Meta(gt=0.0, le=MOST_TIME_S)] | None = None
    """Correlation time of the gusts, seconds, for kind "force"."""

    mean_m_s: Speed | None = None
    """Mean speed of the air, at ``reference_height_m`` if it depends on height. This and all following fields
    are for kind "velocity"."""
    profile: Literal["uniform", "logarithmic"] | None = None
    """Dependence of the mean on the height above the ground: none, or ln(h / roughness length), up to
    `MOST_SPEED_M_S`."""
    reference_height_m: Annotated[float, Meta(ge=0.1, le=500.0)] | None = None
    """At least ten roughness lengths. This and the next field are for profile "logarithmic"."""
    roughness_length_m: Annotated[float, Meta(ge=1e-6, le=5.0)] | None = None
    """0.03 m for open flat terrain with grass, 0.5 m for bushes, 1 m for suburbs (WMO's classification)."""
    turbulence: Literal["none", "dryden", "von_karman"] | None = None
    """Spectrum of the turbulence; its strengths and lengths are those of MIL-F-8785C's low-altitude model.
    The following fields require a value other than "none"."""
    wind_20ft_m_s: Speed | None = None
    """Mean speed 20 feet above the ground, which determines the strength of the turbulence; None: that of the
    mean wind."""
    turbulence_height_m: Annotated[float, Meta(ge=LEAST_SCALE_HEIGHT_M, le=MOST_SCALE_HEIGHT_M)] | None = None
    """Height above the ground that determines scale lengths and strengths for all vehicles at all times;
    None: the formation's height, limited to these bounds."""
    least_passing_speed_m_s: Annotated[float, Meta(ge=0.01, le=60.0)] | None = None
    """Least speed of the turbulence, a frozen pattern that the mean wind carries past hovering vehicles."""

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
        required, refused = ("peak_n", "peak_m_s") if self.kind == "force" else ("peak_m_s", "peak_n")
        for number, gust in enumerate(self.gusts):
            if getattr(gust, required) is None or getattr(gust, refused) is not None:
                raise ValueError(
                    f'gusts[{number}]: expected {required}, and not {refused}, as kind is "{self.kind}"'
                )

    def force_model(self) -> ForceModel:
        """Return the settings for kind "force", with defaults for None."""
        return ForceModel(**self._given(ForceModel))

    def velocity_model(self, formation_height_m: float) -> VelocityModel:
        """Return the settings for kind "velocity", with defaults for None."""
        nearest_m = min(max(formation_height_m, LEAST_SCALE_HEIGHT_M), MOST_SCALE_HEIGHT_M)
        return VelocityModel(**{"turbulence_height_m": nearest_m, **self._given(VelocityModel)})

    def _given(self, model: type[ForceModel | VelocityModel]) -> dict[str, Any]:
        values = {each.name: getattr(self, each.name) for each in fields(model)}
        return {name: value for name, value in values.items() if value is not None}

    def _idle_fields(self) -> dict[str, list[str]]:
        """Return the fields that have a value but no effect, by the reason."""
        idle: dict[str, tuple[str, ...]] = {}
        if self.kind == "force":
            idle['kind is "force"'] = _VELOCITY_FIELDS
        else:
            idle['kind is "velocity"'] = _FORCE_FIELDS
            if self.profile != "logarithmic":
                idle['profile is "uniform"'] = _PROFILE_FIELDS
            if self.turbulence is None or self.turbulence == "none":
                idle['turbulence is "none"'] = ("correlation", *_TURBULENCE_FIELDS)
        given = {
            where: [name for name in names if getattr(self, name) is not None]
            for where, names in idle.items()
        }
        return {where: names for where, names in given.items() if names}


LEAST_REFERENCE_ROUGHNESSES = 10.0
_FORCE_FIELDS = ("mean_n", "gust_rms_fraction", "gust_time_constant_s")
_PROFILE_FIELDS = ("reference_height_m", "roughness_length_m")
_TURBULENCE_FIELDS = ("wind_20ft_m_s", "turbulence_height_m", "least_passing_speed_m_s")
_VELOCITY_FIELDS = ("mean_m_s", "profile", *_PROFILE_FIELDS, "turbulence", *_TURBULENCE_FIELDS)


def direction_ned(direction_deg: float, vertical_fraction: float) -> Array:
    """Return the unit vector (3,) NED of a compass direction and a down component."""
    direction_rad = math.radians(direction_deg)
    horizontal = math.sqrt(1.0 - vertical_fraction**2)
    return np.array(
        [horizontal * math.cos(direction_rad), horizontal * math.sin(direction_rad), vertical_fraction]
    )

"""Whether ranging determines the shape of a scenario's formation, and what to change if it does not.

The prediction is that of `autopilot.onboard.predicted_shape`, for one round of distances, and
its limit is that of the take-off. Flights agree with it: docs/concepts/ranging-and-localisation.md.
"""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from autopilot.onboard.predicted_shape import (
    LOCALISE_TIMEOUT_US,
    SHAPE_STD_M,
    is_near_line,
    linked,
    predicted_shape_std_m,
    width_m,
)
from autopilot.parameters.onboard_config import FORMATION, OnboardConfig
from harness.scenario.scenario import Scenario

PAGE = "docs/concepts/ranging-and-localisation.md#formations-that-ranging-does-not-determine"
"""The explanation for users."""
_LINE_M = 0.01
"""Places within this of a line are reported as on it."""
_SAME: Mapping[str, Any] = MappingProxyType({})


class Prediction(Struct, frozen=True, kw_only=True):
    """Expected accuracy of the neighbourhood that ranging determines worst."""

    uav: int
    """The UAV at which this neighbourhood's filter runs."""
    members: int
    """Number of UAVs of the neighbourhood."""
    shape_std_m: float
    """Expected rms error of its shape."""
    is_near_line: bool
    """Whether more accurate distances between more UAVs would not determine it either."""
    width_m: float
    """Largest horizontal distance of its places from a line."""

    @property
    def localises(self) -> bool:
        """Whether take-off need not wait for its time-out."""
        return self.shape_std_m < SHAPE_STD_M


def predict(scenario: Scenario) -> Prediction:
    """Return the prediction for the neighbourhood with the largest error, on the ground or at the places."""
    places_ned_m, onboard = scenario.places_ned_m(), scenario.onboard
    on_ground_m = places_ned_m * (1.0, 1.0, 0.0)
    near = linked(places_ned_m, onboard.neighbours)
    everywhere: list[Prediction] = []
    for uav in range(scenario.agents):
        members = np.flatnonzero(near[uav] | (np.arange(scenario.agents) == uav))
        among = near[np.ix_(members, members)]
        begin_and_end = on_ground_m[members], places_ned_m[members]
        gps_std_m, distance_std_m = onboard.gps_bias_std_m, _distance_std_m(scenario)
        everywhere.append(
            Prediction(
                uav=uav,
                members=len(members),
                shape_std_m=max(
                    predicted_shape_std_m(each, among, gps_std_m=gps_std_m, distance_std_m=distance_std_m)
                    for each in begin_and_end
                ),
                is_near_line=any(
                    is_near_line(each, gps_std_m=gps_std_m, limit_m=SHAPE_STD_M) for each in begin_and_end
                ),
                width_m=width_m(places_ned_m[members]),
            )
        )
        if among.sum() == scenario.agents * (scenario.agents - 1):  # all are linked: the same for all others
            break
    return max(everywhere, key=lambda each: each.shape_std_m)


def warning(scenario: Scenario) -> str | None:
    """Return one line for the user if take-off will wait for its time-out; None: it does not by prediction.

    None also without ranging, with another application, and for a swarm that waits for a ground station.
    """
    onboard = scenario.onboard
    flies_it = onboard.enabled and onboard.application == FORMATION and not onboard.hold
    if not flies_it or onboard.localisation != "ftm":
        return None
    found = predict(scenario)
    if found.localises:
        return None
    group = f"UAV {found.uav} and its {found.members - 1} neighbours"
    if found.members == scenario.agents:
        group = f"all {found.members} UAVs"
    if not found.is_near_line or _all_neighbours_localise(scenario):
        cause = (
            f"the distances between {group}, each with {_distance_std_m(scenario):.2f} m of standard error, "
            f"determine their shape to {found.shape_std_m:.2f} m only, not {SHAPE_STD_M:g} m"
        )
    else:
        place = "on a line" if found.width_m < _LINE_M else f"within {found.width_m:.2f} m of a line"
        cause = (
            f"the places of {group} lie {place}: ranging does not observe positions across it, which stay "
            f"as inaccurate as GPS (about {onboard.gps_bias_std_m:g} m)"
        )
    remedies = [*_remedies(scenario), "--set onboard.localisation=gps (GPS alone, without the wait)"]
    wait_s = LOCALISE_TIMEOUT_US // 1_000_000
    return f"warning: {cause}, and take-off waits up to {wait_s} s; use {' or '.join(remedies)}; see {PAGE}"


def _distance_std_m(scenario: Scenario) -> float:
    """Return one sigma of what one round of ranging measures of a pair."""
    trip_m, floor_m = scenario.round_trip_std_m, scenario.onboard.range_floor_std_m
    both_ends = 2 if scenario.onboard.ranging == "all_pairs" else 1
    return math.sqrt((trip_m**2 / scenario.round_trips + floor_m**2) / both_ends)


def _all_neighbours_localise(scenario: Scenario) -> bool:
    return scenario.onboard.neighbours > 0 and _localises(scenario, onboard={"neighbours": 0})


def _remedies(scenario: Scenario) -> Iterator[str]:
    """Yield options of the command line, each with which ranging determines the shape."""
    count, shape = scenario.agents, scenario.formation
    if _all_neighbours_localise(scenario):
        for neighbours in range(scenario.onboard.neighbours + 1, count):
            if _localises(scenario, onboard={"neighbours": neighbours}):
                yield f"--set onboard.neighbours={neighbours}"
                return
    elif shape.shape == "grid":
        for columns in range(math.ceil(math.sqrt(count)), 1, -1):
            if _localises(scenario, formation={"columns": columns}):
                yield f"--set formation.columns={columns}"
                break
        places = shape.columns * shape.rows
        for agents in (count + 1, count + 2, places):
            if count < agents <= places and _localises(scenario, agents=agents):
                yield f"--agents {agents}"
                break
    elif _localises(scenario, formation={"shape": "ring"}):
        yield "--set formation.shape=ring"
    if not predict(scenario).is_near_line:
        yield from _accuracies(scenario)


def _accuracies(scenario: Scenario) -> Iterator[str]:
    """Yield options with which distances are accurate enough."""
    for width_mhz in (40, 80):
        if width_mhz > scenario.radio.bandwidth_mhz and _localises(
            scenario, radio={"bandwidth_mhz": width_mhz}
        ):
            yield f"--set radio.bandwidth_mhz={width_mhz}"
            break
    floor_m = OnboardConfig().range_floor_std_m
    if floor_m < scenario.onboard.range_floor_std_m and _localises(
        scenario, onboard={"range_floor_std_m": floor_m}
    ):
        yield f"--set onboard.range_floor_std_m={floor_m:g}"


def _localises(
    scenario: Scenario, *, agents: int | None = None, formation: Mapping[str, Any] = _SAME,
    onboard: Mapping[str, Any] = _SAME, radio: Mapping[str, Any] = _SAME,
) -> bool:  # fmt: skip
    """Return whether the scenario with these changes is valid and localises."""
    replaced = msgspec.structs.replace
    try:
        changed = replaced(
            scenario,
            agents=agents or scenario.agents,
            formation=replaced(scenario.formation, **formation),
            onboard=replaced(scenario.onboard, **onboard),
            radio=replaced(scenario.radio, **radio),
        )
    except ValueError:
        return False
    return predict(changed).localises

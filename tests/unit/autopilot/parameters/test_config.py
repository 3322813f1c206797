"""Settings of a vehicle: every number has bounds, and the application works at all of them."""

import contextlib
import inspect
import itertools
import math

import msgspec
import numpy as np
import pytest
from msgspec import Struct
from msgspec.inspect import DictType, FloatType, StructType, Type, type_info
from onboard_world import SwarmWorld

from autopilot.onboard.formation_plan import FormationPlan, check
from autopilot.parameters import config as settings
from autopilot.parameters.config import RacetrackMotion, TrackMotion
from autopilot.parameters.onboard_config import OnboardConfig

TABLES = [
    table
    for _, table in inspect.getmembers(settings, inspect.isclass)
    if issubclass(table, Struct) and table is not Struct
]
PLACES_NED_M = np.array(((0.0, -4.0, -10.0), (0.0, 4.0, -10.0)))
PAIR = ((-3.0, 0.0, -8.0), (3.0, 0.0, -8.0))


def floats_of(kind: Type) -> list[FloatType]:
    """Return all floats in a field's type; parameters are a dict and have bounds in the autopilot's table."""
    if isinstance(kind, FloatType):
        return [kind]
    if isinstance(kind, StructType | DictType):
        return []
    parts = (*getattr(kind, "types", ()), *getattr(kind, "item_types", ()))
    item = getattr(kind, "item_type", None)
    return [found for part in (*parts, *((item,) if item else ())) for found in floats_of(part)]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_number_has_bounds(table):
    for field in type_info(table).fields:
        for number in floats_of(field.type):
            assert number.le is not None, field.name
            assert number.ge is not None or number.gt is not None, field.name


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e200])
@pytest.mark.parametrize("field", ["gps_bias_std_m", "odometry_drift_m_sqrt_s", "on_station_tolerance_m"])
def test_values_that_overflow_the_filter_are_rejected(field, value):
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({field: value}, OnboardConfig)


def ends(table, *fields):
    """Return all combinations of the bounds of fields."""
    bounds = {
        field.name: floats_of(field.type)[0] for field in type_info(table).fields if field.name in fields
    }
    least_most = [(kind.ge if kind.ge is not None else 1e-6, kind.le) for kind in bounds.values()]
    return [dict(zip(bounds, values, strict=True)) for values in itertools.product(*least_most)]


@pytest.mark.parametrize(
    "motion",
    [
        *(TrackMotion(**end) for end in ends(TrackMotion, "speed_m_s", "acceleration_m_s2", "length_m")),
        *(
            RacetrackMotion(**end)
            for end in ends(RacetrackMotion, "speed_m_s", "acceleration_m_s2", "length_m", "radius_m")
        ),
    ],
    ids=str,
)
def test_a_motion_at_its_bounds_is_flown_or_rejected(motion):
    """Without a warning, which would be an error here; even a rejected motion gives finite plans."""
    with contextlib.suppress(ValueError):
        check(PLACES_NED_M, motion)
    plan = FormationPlan(PLACES_NED_M, 0.0, motion)
    for time_s in (0.0, 1e-3, 1.0, 1e3, 1e6):
        state = plan.at(time_s)
        assert np.isfinite(np.concatenate((state.pos_ned_m, state.vel_ned_m_s, state.acc_ned_m_s2))).all()


@pytest.mark.parametrize(
    "end", ends(OnboardConfig, "gps_bias_std_m", "odometry_drift_m_sqrt_s", "range_floor_std_m"), ids=str
)
def test_estimates_are_finite_at_the_bounds_of_the_filters_settings(end):
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=OnboardConfig(**end))
    world.run(8.0)
    for app in world.apps:
        assert np.isfinite(app.estimate(world.now_us).pos_ned_m).all()
        assert np.isfinite(app.application.localisation.cov).all()
        assert (app.application.localisation.cov.diagonal() >= 0.0).all()

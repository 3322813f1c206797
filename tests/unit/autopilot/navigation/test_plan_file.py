"""Plan files: read as QGroundControl uploads them, written so that reading restores them. Costs 6 s."""

import contextlib
import json
import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_fixtures import refusal
from pymavlink.dialects.v20 import common

from autopilot.__main__ import lone_vehicle
from autopilot.navigation import plan_file, site_plan
from autopilot.navigation.plan_file import HomePlace, PlanFileError, Plans, dumps, loads
from autopilot.navigation.plan_items import (
    circle_item,
    make,
    polygon_items,
    rally_item,
    return_point_item,
)
from autopilot.navigation.plan_store import PlanType, WireItem, make_plan
from autopilot.parameters.config import (
    AutopilotConfig,
    CircleConfig,
    MissionItemConfig,
    RallyPointConfig,
    Site,
)
from foundation.geometry.geodesy import geodetic_to_ned
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load as load_scenario

LAT, LON = 47.397742, 8.545594


def simple(command, *params, frame=3, number=None, **more):
    """Return an item as QGroundControl writes it, with the fields that only QGroundControl uses."""
    return {
        "type": "SimpleItem", "command": command, "frame": frame, "params": list(params),
        "autoContinue": True, "doJumpId": number,
        "AMSLAltAboveTerrain": None, "Altitude": 50, "AltitudeMode": 1, **more,
    }  # fmt: skip


def file_of(*items, fence=None, rally=None, home=(LAT, LON, 488.0)):
    return {
        "fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
        "mission": {
            "version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5,
            "globalPlanAltitudeMode": 1, "plannedHomePosition": home, "items": list(items),
        },
        "geoFence": {"version": 2, "circles": [], "polygons": [], **(fence or {})},
        "rallyPoints": {"version": 2, "points": rally or []},
    }  # fmt: skip


TAKE_OFF = simple(22, 15, 0, 0, None, LAT, LON, 10, number=1)
SURVEY = {
    "type": "ComplexItem", "complexItemType": "survey", "version": 5, "angle": 0,
    "TransectStyleComplexItem": {
        "version": 2,
        "Items": [
            simple(16, 0, 0, 0, None, LAT + 1e-4, LON, 20, number=2),
            simple(206, 25, 0, 1, 0, 0, 0, 0, frame=2, number=3),
            simple(16, 0, 0, 0, None, LAT + 1e-4, LON + 1e-4, 20, number=4),
            simple(206, 0, 0, 1, 0, 0, 0, 0, frame=2, number=5),
        ],
    },
}  # fmt: skip
JUMP = simple(177, 2, 3, 0, 0, 0, 0, 0, frame=2, number=6)
HOME = simple(20, 0, 0, 0, 0, 0, 0, 0, frame=2, number=7)
FENCE = {
    "circles": [{"circle": {"center": [LAT, LON], "radius": 250.5}, "inclusion": True, "version": 1}],
    "polygons": [
        {"polygon": [[LAT, LON], [LAT, LON + 1e-3], [LAT + 1e-3, LON]], "inclusion": False, "version": 1}
    ],
    "breachReturn": [LAT, LON, 30],
}
SAMPLE = file_of(TAKE_OFF, SURVEY, JUMP, HOME, fence=FENCE, rally=[[LAT, LON + 2e-3, 40.0]])


def test_a_file_is_read_as_it_would_be_uploaded():
    plans = loads(json.dumps(SAMPLE))
    assert [item.command for item in plans.mission] == [22, 16, 206, 16, 206, 177, 20]
    take_off, first, photos, _, _, jump, _ = plans.mission
    assert (take_off.x, take_off.y, take_off.z) == (round(LAT * 1e7), round(LON * 1e7), 10.0)
    assert (take_off.params[0], math.isnan(take_off.params[3])) == (15.0, True)
    assert first.x == round((LAT + 1e-4) * 1e7)
    assert (photos.frame, photos.params) == (2, (25.0, 0.0, 1.0, 0.0))
    # number 2 is the item of index 1: QGroundControl counts home as the item before the first
    assert jump.params[:2] == (1.0, 3.0)
    assert plans.fence == (
        *polygon_items([(LAT, LON), (LAT, LON + 1e-3), (LAT + 1e-3, LON)], inclusion=False),
        circle_item(LAT, LON, 250.5, inclusion=True),
        return_point_item(LAT, LON, 30.0),
    )
    assert plans.rally == (rally_item(LAT, LON + 2e-3, 40.0),)
    assert plans.home == HomePlace(LAT, LON, 488.0)
    assert [refusal(kind, plans.of(kind)) for kind in PlanType] == [None, None, None]


def bits(items):
    """Return values that compare equal for equal lists, including not-a-number."""
    return make_plan(items).opaque_id, len(items)


def test_reading_restores_a_written_file():
    plans = loads(json.dumps(SAMPLE))
    text = dumps(plans)
    again = loads(text)
    for kind in PlanType:
        assert bits(again.of(kind)) == bits(plans.of(kind))
    assert again.home == plans.home
    assert dumps(again) == text
    assert json.loads(text)["mission"]["items"][5]["params"][0] == 2  # QGroundControl's numbering


float32s = st.floats(-1e6, 1e6, width=32) | st.just(math.nan)
placed = st.builds(
    WireItem,
    command=st.just(common.MAV_CMD_NAV_WAYPOINT),
    frame=st.sampled_from([0, 3, 5, 6]),
    params=st.tuples(st.floats(0.0, 1e4, width=32), st.just(math.nan), float32s, float32s),
    x=st.integers(-900_000_000, 900_000_000),
    y=st.integers(-1_800_000_000, 1_800_000_000),
    z=st.floats(-1e4, 1e4, width=32),
    autocontinue=st.integers(0, 1),
)
loads_of = st.builds(
    WireItem,
    command=st.sampled_from([2000, 2500, 206, 1000, 203]),
    frame=st.sampled_from([2, 2, 6]),
    params=st.tuples(float32s, float32s, float32s, float32s),
    x=st.integers(-(2**31) + 1, 2**31 - 1),
    y=st.integers(-(2**31) + 1, 2**31 - 1),
    z=float32s,
    autocontinue=st.integers(0, 1),
)


@settings(deadline=None, max_examples=100)
@given(placed, st.lists(placed | loads_of, max_size=5), st.integers(1, 9))
def test_any_mission_is_restored_bit_for_bit(first, others, count):
    back = WireItem(command=177, frame=2, params=(0.0, float(count), 0.0, 0.0), x=0, y=0, z=0.0)
    items = (first, *others, back)
    again = loads(dumps(Plans(mission=items)))
    assert bits(again.mission) == bits(items)


def changed(**fields):
    return {**SAMPLE, **fields}


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("{", "not JSON"),
        ('{"fileType": NaN}', "NaN is not a number"),
        ([], "plan: expected an object"),
        (changed(fileType="Mission"), '"fileType" must be "Plan"'),
        (changed(version=2), '"version" 1'),
        (changed(mission={"version": 1, "items": []}), "mission: version 1, expected 2"),
        (changed(geoFence=[1]), "geoFence: expected an object"),
        (changed(rallyPoints={"version": 2, "points": [[1, 2]]}), "points[0]: expected 3 numbers"),
        (changed(rallyPoints={"version": 2, "points": [[91, 2, 3]]}), "91, 2 is not a valid latitude"),
        (file_of(TAKE_OFF, {"type": "ComplexItem", "complexItemType": "StructureScan"}),
         "mission.items[1]: 'StructureScan' without items"),
        (file_of(simple(16, 0, 0, 0, None, LAT, LON)), "items[0].params: expected 7 numbers"),
        (file_of(simple(16, 0, 0, 0, "x", LAT, LON, 3)), "items[0].params: expected a number"),
        (file_of(simple(16, 0, 0, 0, 0, 300, LON, 3)), "params: 300, 8.54559 is not a valid latitude"),
        (file_of({**TAKE_OFF, "frame": "3"}), "mission.items[0].frame: expected a whole number"),
        (file_of({**TAKE_OFF, "autoContinue": 1}), "autoContinue: expected true or false"),
        (file_of(TAKE_OFF, simple(177, 9, 1, 0, 0, 0, 0, 0, frame=2, number=[2])), "jumps to item 9"),
        (file_of(simple(16, 0, 0, 0, None, LAT, LON, 9, frame=10)), "mission: Item 0: frame 10"),
        (file_of(simple(84, 0, 0, 0, None, LAT, LON, 9)), "NAV_VTOL_TAKEOFF is not supported"),
        (file_of(fence={"polygons": [{"polygon": [[LAT, LON]] * 3, "inclusion": True}]}), "repeats"),
        (file_of(fence={"circles": [{"circle": {"center": [LAT, LON], "radius": -1}, "inclusion": True}]}),
         "fence: Item 0"),
        (file_of(fence={"circles": [{"circle": {"center": [LAT, LON]}, "inclusion": True}]}),
         "geoFence.circles[0].circle.radius: expected a number"),
        (file_of(home=[LAT]), "plannedHomePosition: expected 2 numbers"),
        (file_of(rally=[[LAT, LON, 5.0]] * 81), "rally: 81 items, 80 at most"),
    ],
)  # fmt: skip
def test_a_bad_file_gives_a_one_line_error_with_the_location(file, words):
    text = file if isinstance(file, str) else json.dumps(file)
    with pytest.raises(PlanFileError) as caught:
        loads(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


KEYS = (
    "mission", "geoFence", "rallyPoints", "items", "params", 0, "polygons", "circles", "circle", "center",
    "points", "doJumpId", "command",
)  # fmt: skip
json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


@settings(deadline=None, max_examples=200)
@given(st.lists(st.sampled_from(KEYS), min_size=1, max_size=5), json_values)
def test_no_contents_raise_other_errors(way, value):
    file = json.loads(json.dumps(SAMPLE))
    inner = file
    for key in way:
        try:
            below = inner[key]
        except (KeyError, IndexError, TypeError):
            break
        if not isinstance(below, dict | list):
            inner[key] = value
            break
        inner = below
    with contextlib.suppress(PlanFileError):
        loads(json.dumps(file))


@pytest.mark.parametrize(
    ("home", "read"),
    [
        (None, None),
        ([None, None, None], None),
        ([LAT, LON], HomePlace(LAT, LON, 0.0)),
        ([LAT, LON, None], HomePlace(LAT, LON, 0.0)),
    ],
)
def test_a_planned_home_may_be_missing(home, read):
    plans = loads(json.dumps(file_of(TAKE_OFF, home=home)))
    assert plans.home == read
    assert bits(loads(dumps(plans)).mission) == bits(plans.mission)


# ---- in a scenario


def write_scenario(folder, toml, plan=SAMPLE):
    (folder / "site.plan").write_text(json.dumps(plan))
    (folder / "flight.toml").write_text(f"agents = 2\n[onboard]\nenabled = false\n[autopilot]\n{toml}\n")
    return folder / "flight.toml"


def test_a_scenario_refers_to_a_plan_file_next_to_it(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path, 'plan_file = "site.plan"'))
    config = scenario.vehicle_config(1, run_id="r", radio_endpoint=None, log_path=None)
    config = msgspec.json.decode(msgspec.json.encode(config), type=type(config))  # as passed to the process
    plans = site_plan.plans(config.autopilot, config.site)
    read = loads(json.dumps(SAMPLE))
    for kind in PlanType:
        assert bits(plans[kind].items) == bits(read.of(kind))
    mission, fence, rally = (plans[kind].made for kind in PlanType)
    assert (len(mission.mission.items), len(fence.fence_shapes), len(rally.rally_points)) == (7, 2, 1)


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ('plan_file = "nowhere.plan"', "nowhere.plan: there is no such file"),
        ('plan_file = "flight.toml"', "flight.toml: not JSON"),
        ('plan_file = "site.plan"\nmission = [{command = "land"}]', "mission: also defined in the plan file"),
        (
            'plan_file = "site.plan"\nrally = [{north_m = 1, east_m = 2}]',
            "rally: also defined in the plan file",
        ),
        ('plan_file = "site.plan"\nplan = \'{"fileType": "Plan", "version": 1}\'', "autopilot.plan, too"),
        ('plan = "{}"', "autopilot: plan: not a plan"),
    ],
)
def test_a_bad_plan_of_a_scenario_gives_a_one_line_error(tmp_path, toml, words):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(write_scenario(tmp_path, toml))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_lone_vehicle_starts_with_a_plan_file(tmp_path):
    (tmp_path / "site.plan").write_text(json.dumps(SAMPLE))
    config = lone_vehicle(0, 1.0, None, tmp_path / "site.plan")
    assert len(site_plan.plans(config.autopilot, config.site)[PlanType.MISSION].items) == 7
    with pytest.raises(PlanFileError, match=r"nowhere.plan: there is no such file"):
        lone_vehicle(0, 1.0, None, tmp_path / "nowhere.plan")


def test_stations_can_read_plans_in_metres_of_the_site():
    config = AutopilotConfig(
        mission=(MissionItemConfig(command="takeoff", height_m=5.0),
                 MissionItemConfig(command="waypoint", north_m=20.0, east_m=0.0, height_m=5.0)),
        fence=(CircleConfig(radius_m=60.0),),
        rally=(RallyPointConfig(north_m=30.0, east_m=-10.0, height_m=5.0),),
    )  # fmt: skip
    plans = site_plan.plans(config, Site())
    assert [item.command for item in plans[PlanType.MISSION].items] == [22, 16]
    assert plans[PlanType.FENCE].items[0].params[0] == 60.0
    (point,) = plans[PlanType.RALLY].made.rally_points
    site = Site()
    north_m, east_m, _ = geodetic_to_ned(
        point.lat_deg, point.lon_deg, site.altitude_m, origin_lat_deg=site.latitude_deg,
        origin_lon_deg=site.longitude_deg, origin_alt_m=site.altitude_m,
    )  # fmt: skip
    assert math.hypot(north_m - 30.0, east_m + 10.0) < 0.012  # 1e-7 degrees
    assert point.height_m == 5.0
    for kind in PlanType:
        assert make(kind, plans[kind].items) == plans[kind].made
    again = loads(plan_file.dumps(Plans(*(plans[kind].items for kind in PlanType))))
    assert bits(again.mission) == bits(plans[PlanType.MISSION].items)

"""Plans uploaded over MAVLink and flown by the whole vehicle with the physics. Costs 30 s."""

import json
import math

import pytest
from plan_flights import act, flight_of, make_ready, of_site, place, reached, said, upload
from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.plan_items import make, polygon_items, rally_item
from autopilot.navigation.plan_store import PlanType
from autopilot.parameters.config import CircleConfig, MissionItemConfig, RallyPointConfig, Site
from autopilot.services.mission_progress import ACTIVE, COMPLETE, NO_MISSION, NOT_STARTED, PAUSED

ACCEPTED = common.MAV_RESULT_ACCEPTED
TAKEOFF, WAYPOINT, LAND = common.MAV_CMD_NAV_TAKEOFF, common.MAV_CMD_NAV_WAYPOINT, common.MAV_CMD_NAV_LAND
HOLD, MISSION = (1.0, 4.0, 3.0), (1.0, 4.0, 4.0)


def set_mode(flight, mode):
    assert flight.command(common.MAV_CMD_DO_SET_MODE, *mode) == ACCEPTED


def state(flight):
    return flight.vehicle.messaging.missions.state


def test_a_mission_is_uploaded_flown_paused_and_continued():
    with flight_of() as flight:
        flight.step()
        assert state(flight) == NO_MISSION
        items = [
            act(common.MAV_CMD_SET_CAMERA_MODE, 0.0, 1.0),
            place(flight, TAKEOFF, 0.0, 0.0, 5.0),
            act(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, 3.0, -1.0),
            place(flight, WAYPOINT, 15.0, 0.0, 5.0),
            act(common.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0, 1.0),
            place(flight, WAYPOINT, 15.0, 10.0, 6.0),
            act(common.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -30.0),
            act(common.MAV_CMD_DO_JUMP, 3.0, 1.0),
            act(LAND)._replace(frame=common.MAV_FRAME_GLOBAL_RELATIVE_ALT),
        ]
        assert upload(flight, items) == common.MAV_MISSION_ACCEPTED
        assert flight.vehicle.messaging.plans[PlanType.MISSION].items == tuple(items) or math.isnan(
            items[1].params[3]
        )
        make_ready(flight)
        assert (state(flight), reached(flight)) == (NOT_STARTED, [])  # nothing is executed on the ground
        commander = flight.vehicle.commander
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        assert flight.run(30.0, until=lambda: 3 in reached(flight))
        assert state(flight) == ACTIVE
        set_mode(flight, HOLD)
        flight.run(4.0)
        assert (state(flight), commander.mode) == (PAUSED, FlightMode.HOLD)
        assert max(abs(flight.vehicle.flight.state.vel_ned_m_s)) < 0.3
        indices = reached(flight)
        set_mode(flight, MISSION)
        speeds_m_s = []

        def landed():
            north_m_s, east_m_s, _ = flight.vehicle.flight.state.vel_ned_m_s
            speeds_m_s.append(math.hypot(north_m_s, east_m_s))
            return not commander.armed

        assert flight.run(90.0, until=landed)
        assert indices == [0, 1, 2, 3, 4]
        # the jump leads back to 3 once, and is not reported
        assert reached(flight) == [0, 1, 2, 3, 4, 5, 6, 3, 4, 5, 6, 8]
        assert 2.5 < max(speeds_m_s) < 3.4  # DO_CHANGE_SPEED of 3 m/s also applies after the pause
        assert state(flight) == COMPLETE
        photos = [text for text in flight.texts() if text == "Mission: take photo (item 4)"]
        assert len(photos) == 2
        assert "Mission: turn gimbal (item 6)" in flight.texts()
        current = said(flight, "MISSION_CURRENT")
        assert {message.total for message in current if message.mission_state != NO_MISSION} == {9}
        assert (current[-1].seq, current[-1].mission_state) == (8, COMPLETE)
        assert current[-1].mission_id == flight.vehicle.messaging.plans[PlanType.MISSION].opaque_id


def test_a_mission_uploaded_in_flight_starts_the_same_changes_nothing_and_none_holds():
    with flight_of() as flight:
        flight.step()
        first = [place(flight, TAKEOFF, 0.0, 0.0, 5.0), place(flight, WAYPOINT, 20.0, 0.0, 5.0),
                 place(flight, WAYPOINT, 20.0, 20.0, 5.0)]  # fmt: skip
        assert upload(flight, first) == common.MAV_MISSION_ACCEPTED
        make_ready(flight)
        set_mode(flight, MISSION)
        runner, vehicle = flight.vehicle.pilot.navigator.mission.runner, flight.vehicle
        assert flight.run(30.0, until=lambda: runner.current == 2)
        version = runner.version
        assert upload(flight, first) == common.MAV_MISSION_ACCEPTED
        assert (runner.current, runner.version) == (2, version)
        second = [place(flight, WAYPOINT, 10.0, 5.0, 6.0), place(flight, WAYPOINT, 0.0, 5.0, 6.0)]
        assert upload(flight, second) == common.MAV_MISSION_ACCEPTED
        flight.step()
        assert (runner.current, vehicle.commander.mode) == (0, FlightMode.MISSION)
        assert flight.run(30.0, until=lambda: runner.current == 1)
        wrong = [first[1], act(common.MAV_CMD_NAV_VTOL_LAND)]
        assert upload(flight, wrong) == common.MAV_MISSION_UNSUPPORTED
        assert flight.texts()[-1].endswith("Item 1: NAV_VTOL_LAND is not supported")
        assert (runner.current, len(runner.mission.items)) == (1, 2)
        flight.send(common.MAVLink_mission_clear_all_message(1, 1, int(PlanType.MISSION)))
        flight.run(4.0)
        assert vehicle.commander.mode is FlightMode.HOLD
        assert not vehicle.commander.failsafe
        assert (state(flight), max(abs(vehicle.flight.state.vel_ned_m_s)) < 0.3) == (NO_MISSION, True)


def test_a_mission_far_from_home_causes_one_warning_and_is_flown():
    with flight_of() as flight:
        flight.step()
        leg = [place(flight, TAKEOFF, 0.0, 0.0, 5.0), place(flight, WAYPOINT, 40.0, 0.0, 5.0)]
        assert upload(flight, leg) == common.MAV_MISSION_ACCEPTED
        make_ready(flight)
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        commander, vehicle = flight.vehicle.commander, flight.vehicle
        runner = vehicle.pilot.navigator.mission.runner
        assert flight.run(20.0, until=lambda: runner.current == 1)
        lat_e7, lon_e7 = of_site(3_000.0, 0.0, vehicle.config.site)
        flight.send(
            common.MAVLink_set_home_position_message(
                1, lat_e7, lon_e7, 488_000, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
            )
        )
        for name, value in ((b"MIS_DIST_1WP", 10.0), (b"GF_MAX_HOR_DIST", 5000.0)):
            flight.send(common.MAVLink_param_set_message(1, 1, name, value, common.MAV_PARAM_TYPE_REAL32))
        flight.run(1.0)
        assert vehicle.flight.home.pos_ned_m[0] > 2_000.0
        assert (commander.mode, commander.failsafe) == (FlightMode.MISSION, False)
        assert flight.run(30.0, until=lambda: state(flight) == COMPLETE)
        warnings = [text for text in flight.texts() if "far away from home" in text]
        assert warnings == []
        assert upload(flight, [place(flight, WAYPOINT, 30.0, 0.0, 6.0)]) == common.MAV_MISSION_ACCEPTED
        flight.step()
        assert "m. Correct mission loaded?" in "".join(flight.texts())
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        assert flight.run(30.0, until=lambda: state(flight) == COMPLETE)


def test_a_mission_outside_the_fence_is_stored_and_not_flown():
    def fence(north_m):
        corners = ((-30.0, -30.0), (-30.0, 30.0), (north_m, 30.0), (north_m, -30.0))
        vertices = [tuple(e7 / 1e7 for e7 in of_site(*corner, Site())) for corner in corners]
        return polygon_items(vertices, inclusion=True)

    with flight_of({"GF_ACTION": 0}) as flight:
        flight.step()
        leg = [place(flight, TAKEOFF, 0.0, 0.0, 5.0), place(flight, WAYPOINT, 40.0, 0.0, 5.0)]
        assert upload(flight, fence(30.0), PlanType.FENCE) == common.MAV_MISSION_ACCEPTED
        assert upload(flight, leg) == common.MAV_MISSION_ACCEPTED
        make_ready(flight)  # the check needs a home position
        commander = flight.vehicle.commander
        text = "Mission rejected: Geofence violation for waypoint 2"
        assert "".join(flight.texts()).count(text) == 1
        assert (state(flight), flight.command(common.MAV_CMD_MISSION_START)) == (
            NO_MISSION, common.MAV_RESULT_DENIED,
        )  # fmt: skip
        assert flight.command(common.MAV_CMD_DO_SET_MODE, *MISSION) != ACCEPTED
        assert upload(flight, fence(60.0), PlanType.FENCE) == common.MAV_MISSION_ACCEPTED
        for limit_m, expected in ((35.0, NO_MISSION), (0.0, NOT_STARTED)):
            flight.vehicle.parameters.set("GF_MAX_HOR_DIST", limit_m)
            flight.step()
            assert state(flight) == expected
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        runner = flight.vehicle.pilot.navigator.mission.runner
        assert flight.run(20.0, until=lambda: runner.current == 1)
        flight.run(2.0)
        assert upload(flight, fence(30.0), PlanType.FENCE) == common.MAV_MISSION_ACCEPTED
        flight.run(4.0)
        assert (commander.mode, commander.failsafe) == (FlightMode.HOLD, False)  # as PX4 loiters
        assert max(abs(flight.vehicle.flight.state.vel_ned_m_s)) < 0.3
        assert "".join(flight.texts()).count(text) == 3
        flight.send(common.MAVLink_mission_clear_all_message(1, 1, int(PlanType.FENCE)))
        flight.step()
        set_mode(flight, MISSION)
        assert flight.run(30.0, until=lambda: state(flight) == COMPLETE)


def test_plans_of_a_scenario_are_the_same_for_stations_and_in_flight():
    with flight_of(
        mission=(MissionItemConfig(command="waypoint", north_m=12.3456789, east_m=1.0, height_m=5.1),),
        fence=(CircleConfig(north_m=1.2345678, radius_m=60.1),),
        rally=(RallyPointConfig(north_m=30.0, east_m=-10.0),),
    ) as flight:
        vehicle, plans = flight.vehicle, flight.vehicle.messaging.plans
        for kind in PlanType:
            assert plans[kind].made == make(kind, plans[kind].items)
        assert vehicle.pilot.navigator.mission.runner.mission is plans[PlanType.MISSION].made.mission
        assert vehicle.monitor.geofence.shapes == plans[PlanType.FENCE].made.fence_shapes != ()
        assert plans.version == dict.fromkeys(PlanType, 1)


def test_return_is_to_the_nearest_rally_point_and_lands_there():
    with flight_of({"RTL_RETURN_ALT": 8.0, "RTL_MIN_DIST": 1.0}) as flight:
        flight.step()
        site = Site()
        near_home, near, far = (
            rally_item(*(e7 / 1e7 for e7 in of_site(*where, site)), 0.0)
            for where in ((5.0, 5.0), (25.0, 10.0), (90.0, 0.0))
        )
        assert upload(flight, [far, near_home, near], PlanType.RALLY) == common.MAV_MISSION_ACCEPTED
        leg = [place(flight, TAKEOFF, 0.0, 0.0, 5.0), place(flight, WAYPOINT, 20.0, 0.0, 5.0)]
        assert upload(flight, leg) == common.MAV_MISSION_ACCEPTED
        make_ready(flight)
        set_mode(flight, MISSION)
        commander = flight.vehicle.commander
        assert flight.run(40.0, until=lambda: commander.mode is FlightMode.HOLD)
        assert flight.command(common.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
        assert flight.run(60.0, until=lambda: not commander.armed)
        ned_m = flight.vehicle.flight.state.pos_ned_m + flight.vehicle.site.origin_ned_m(
            flight.vehicle.flight.state
        )
        assert math.dist(ned_m[:2], (25.0, 10.0)) < 0.8
        assert flight.height_m == pytest.approx(0.0, abs=0.05)


def plan_text(site):
    def at(north_m, east_m):
        return [e7 / 1e7 for e7 in of_site(north_m, east_m, site)]

    square = [at(-20.0, -20.0), at(-20.0, 20.0), at(60.0, 20.0), at(60.0, -20.0)]
    strip = [at(15.0, -30.0), at(15.0, 30.0), at(30.0, 30.0), at(30.0, -30.0)]  # across the path
    simple = {"type": "SimpleItem", "autoContinue": True, "frame": 3}
    return json.dumps({
        "fileType": "Plan", "version": 1,
        "mission": {"version": 2, "items": [
            {**simple, "command": TAKEOFF, "params": [0, 0, 0, None, *at(0.0, 0.0), 5], "doJumpId": 1},
            {**simple, "command": WAYPOINT, "params": [0, 0, 0, None, *at(40.0, 0.0), 5], "doJumpId": 2},
        ]},
        "geoFence": {"version": 2, "circles": [],
                     "polygons": [{"inclusion": True, "polygon": square, "version": 1},
                                  {"inclusion": False, "polygon": strip, "version": 1}]},
        "rallyPoints": {"version": 2, "points": []},
    })  # fmt: skip


def test_the_fence_of_a_plan_file_applies_until_another_is_uploaded():
    with flight_of({"GF_ACTION": 2, "GF_PREDICT": 1}, plan=plan_text(Site())) as flight:
        make_ready(flight)
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        commander, vehicle = flight.vehicle.commander, flight.vehicle
        north_m = []

        def north():
            ned_m = vehicle.flight.state.pos_ned_m + vehicle.site.origin_ned_m(vehicle.flight.state)
            north_m.append(float(ned_m[0]))
            return commander.failsafe

        assert flight.run(30.0, until=north)
        assert commander.mode is FlightMode.HOLD
        flight.run(4.0, until=lambda: north() and False)
        # predicted where v^2 / 2a leads over the border, twice in 0.2 s; braking takes v a / 2j more than
        # that
        speed_m_s, acc_m_s2, jerk_m_s3 = 5.0, 3.0, 4.0
        late_m = 0.2 * speed_m_s + 0.5 * speed_m_s * acc_m_s2 / jerk_m_s3
        assert 15.0 - speed_m_s**2 / (2.0 * acc_m_s2) < max(north_m) < 15.0 + late_m
        wide = [(47.6, 8.3), (47.6, 8.8), (47.2, 8.8), (47.2, 8.3)]
        assert upload(flight, polygon_items(wide, inclusion=True), PlanType.FENCE) == 0
        flight.run(1.0)
        assert vehicle.monitor.breach is None
        set_mode(flight, MISSION)
        assert flight.run(30.0, until=lambda: vehicle.messaging.missions.state == COMPLETE)
        assert not commander.failsafe
        # and one around a place away from the vehicle: an immediate breach
        assert (
            upload(
                flight, polygon_items([(48.0, 8.0), (48.0, 8.1), (48.1, 8.0)], inclusion=True), PlanType.FENCE
            )
            == 0
        )
        flight.run(1.0)
        assert commander.failsafe

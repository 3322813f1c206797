"""The whole vehicle in modes and failsafes other than take-off and offboard, as a ground station sees it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import AutopilotConfig, CircleConfig, MissionItemConfig
from autopilot.parameters.table import ROWS, ParameterError, ParameterSet, Settings
from autopilot.vehicle.vehicle import DECISION_PERIOD_US

NAN = math.nan
ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
REFUSED, UNSUPPORTED = common.MAV_RESULT_TEMPORARILY_REJECTED, common.MAV_RESULT_UNSUPPORTED
ARM = common.MAV_CMD_COMPONENT_ARM_DISARM
TAKE_OFF = common.MAV_CMD_NAV_TAKEOFF


def flight_of(**autopilot):
    config = replace(vehicle_config(), autopilot=AutopilotConfig(**autopilot), params_path="somewhere")
    return Flight(config)


def make_ready(flight):
    commander = flight.vehicle.commander
    assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
    commander.disarm()


def set_parameter(flight, name, value, kind=common.MAV_PARAM_TYPE_REAL32):
    flight.send(common.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    flight.step()


def modes_of(flight, *, after_us):
    return [mode for time_us, mode, _ in flight.modes if time_us > after_us]


def sticks(flight, *, x=0, y=0, z=500, r=0):
    flight.send(common.MAVLink_manual_control_message(1, x, y, z, r, 0))


def with_sticks(flight, seconds, **axes):
    """Fly for some time with stick input at 20 Hz."""
    for _ in range(round(seconds / 0.048)):
        sticks(flight, **axes)
        flight.run(0.048)


def test_a_mission_of_the_scenario_is_flown_to_its_end():
    items = (
        MissionItemConfig(command="takeoff", height_m=4.0),
        MissionItemConfig(command="waypoint", north_m=12.0, east_m=0.0, height_m=5.0),
        MissionItemConfig(command="waypoint", north_m=12.0, east_m=10.0, height_m=5.0),
        MissionItemConfig(command="return"),
    )
    with flight_of(mission=items, params={"RTL_RETURN_ALT": 6.0, "NAV_ACC_RAD": 1.0}) as flight:
        make_ready(flight)
        commander, runner = flight.vehicle.commander, flight.vehicle.pilot.navigator.mission.runner
        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        assert commander.armed
        assert commander.mode is FlightMode.MISSION
        # the site's frame is that of GPS, which has errors of metres: the estimate is what is flown
        origin_ned_m = None
        closest_m = [math.inf, math.inf]

        def passed():
            nonlocal origin_ned_m
            state = flight.vehicle.flight.state
            origin_ned_m = flight.vehicle.site.origin_ned_m(state)
            pos_ne_m = (state.pos_ned_m + origin_ned_m)[:2]
            for i, place in enumerate(((12.0, 0.0), (12.0, 10.0))):
                closest_m[i] = min(closest_m[i], math.dist(pos_ne_m, place))
            return commander.mode is FlightMode.RETURN

        assert flight.run(60.0, until=passed)
        assert max(closest_m) < 1.0
        assert runner.finished
        home_ned_m = flight.vehicle.flight.home.pos_ned_m
        assert flight.run(60.0, until=lambda: not commander.armed)
        assert math.dist(flight.vehicle.flight.state.pos_ned_m[:2], home_ned_m[:2]) < 0.8
        assert flight.height_m == pytest.approx(0.0, abs=0.05)
        assert modes_of(flight, after_us=0)[-3:] == ["Mission", "Return", "Hold"]


def test_mission_mode_is_refused_without_a_mission():
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        assert flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == REFUSED
        assert flight.texts()[-1] == "Mode denied: no valid mission"


def test_return_climbs_flies_home_and_lands():
    with flight_of(params={"RTL_RETURN_ALT": 8.0, "RTL_DESCEND_ALT": 6.0, "RTL_MIN_DIST": 1.0}) as flight:
        flight.take_off(5.0)
        pilot = flight.vehicle.pilot
        pilot.takeoff_altitude.amsl_m = None
        for _ in range(120):  # 12 m to the north by offboard
            flight.send(
                common.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, common.MAV_FRAME_LOCAL_NED, 0b1101_1111_1000, 12.0, 0.0, -5.0, *[0.0] * 8
                )
            )
            flight.run(0.05)
            if flight.vehicle.commander.mode is FlightMode.HOLD:
                flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0)
        assert flight.command(common.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
        highest_m = [0.0]

        def landed():
            highest_m[0] = max(highest_m[0], -float(flight.vehicle.flight.state.pos_ned_m[2]))
            return not flight.vehicle.commander.armed

        assert flight.run(60.0, until=landed)
        assert highest_m[0] == pytest.approx(8.0, abs=0.4)
        home_ned_m = flight.vehicle.flight.home.pos_ned_m
        assert math.dist(flight.vehicle.flight.state.pos_ned_m[:2], home_ned_m[:2]) < 0.8


def test_the_landed_state_of_missions_and_returns_is_that_of_modes():
    items = (
        MissionItemConfig(command="takeoff", height_m=4.0),
        MissionItemConfig(command="waypoint", north_m=8.0, east_m=0.0, height_m=4.0),
        MissionItemConfig(command="land", north_m=8.0, east_m=0.0),
    )
    ground, air, taking_off, landing = (
        common.MAV_LANDED_STATE_ON_GROUND,
        common.MAV_LANDED_STATE_IN_AIR,
        common.MAV_LANDED_STATE_TAKEOFF,
        common.MAV_LANDED_STATE_LANDING,
    )
    with flight_of(mission=items) as flight:
        make_ready(flight)
        states = [ground]

        def is_over():
            state = flight.vehicle.messaging.telemetry.system.extended_sys_state().landed_state
            if states[-1] != state:
                states.append(state)
            return not flight.vehicle.commander.armed

        assert flight.command(common.MAV_CMD_MISSION_START) == ACCEPTED
        assert flight.run(60.0, until=is_over)
        assert states == [ground, taking_off, air, landing, ground]
        states[:] = [ground]
        assert flight.command(ARM, 1.0) == ACCEPTED
        assert flight.command(TAKE_OFF, *[NAN] * 7) == ACCEPTED
        flight.run(20.0, until=lambda: is_over() or flight.vehicle.commander.mode is FlightMode.HOLD)
        assert flight.command(common.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
        assert flight.run(90.0, until=is_over)
        assert states == [ground, taking_off, air, landing, ground]


def test_position_mode_by_sticks_and_the_loss_of_manual_control():
    with flight_of(params={"RTL_RETURN_ALT": 6.0}) as flight:
        flight.take_off(5.0)
        commander, state = flight.vehicle.commander, flight.vehicle.flight.state
        assert flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 3.0, 0.0) == REFUSED
        assert flight.texts()[-1] == "Mode denied: no manual control"
        begin_ned_m = state.pos_ned_m.copy()
        with_sticks(flight, 2.0, x=900)  # stick movement takes over from hold
        assert commander.mode is FlightMode.POSITION
        speed_m_s = math.hypot(*state.vel_ned_m_s[:2])
        assert speed_m_s > 2.0
        with_sticks(flight, 5.0)
        assert math.hypot(*state.vel_ned_m_s[:2]) < 0.2
        assert math.dist(state.pos_ned_m[:2], begin_ned_m[:2]) > 5.0
        gone_us = flight.now_us
        assert flight.run(1.0, until=lambda: commander.mode is FlightMode.HOLD)
        assert flight.now_us - gone_us == pytest.approx(500_000, abs=60_000)  # COM_RC_LOSS_T
        assert flight.texts()[-1] == "Failsafe: no manual control, Hold, Return in 5 s"
        assert flight.run(5.1, until=lambda: commander.mode is FlightMode.RETURN)


def test_altitude_and_stabilised_need_no_gps_and_take_off_by_throttle():
    with Flight(vehicle_config(), gps=False) as flight:
        for _ in range(100):
            sticks(flight, z=0)
            flight.run(0.048)
        assert flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 2.0, 0.0) == ACCEPTED
        assert flight.command(ARM, 1.0) == ACCEPTED
        with_sticks(flight, 6.0, z=800)
        assert flight.height_m > 1.0
        with_sticks(flight, 2.0)
        held_m = float(flight.vehicle.flight.state.pos_ned_m[2])
        with_sticks(flight, 3.0)
        assert float(flight.vehicle.flight.state.pos_ned_m[2]) == pytest.approx(held_m, abs=0.3)
        assert flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 7.0, 0.0) == ACCEPTED
        with_sticks(flight, 1.0, y=500)
        roll_rad = 2.0 * math.asin(flight.world.truth.q_ned_frd[0, 1])
        assert math.degrees(roll_rad) > 5.0
        with_sticks(flight, 1.5)
        roll_rad = 2.0 * math.asin(flight.world.truth.q_ned_frd[0, 1])
        assert abs(math.degrees(roll_rad)) < 5.0


def test_a_battery_that_runs_down_is_reported_and_lands_the_vehicle():
    with flight_of(params={"COM_LOW_BAT_ACT": 2}) as flight:
        flight.take_off(5.0)
        commander, battery = flight.vehicle.commander, flight.vehicle.monitor.battery
        status = flight.vehicle.messaging.telemetry.system.battery_status()
        assert status.battery_remaining == pytest.approx(100.0 * battery.remaining, abs=1.0)
        assert status.current_battery == pytest.approx(1700.0, rel=0.1)  # four motors of 4 A, and 1 A
        drawn_mah = battery.consumed_mah
        set_parameter(flight, "BAT1_CAPACITY", drawn_mah / 0.92)  # acts immediately
        assert flight.run(8.0, until=lambda: commander.mode is FlightMode.HOLD and commander.failsafe)
        assert flight.run(5.1, until=lambda: commander.mode is FlightMode.LAND)
        assert any(text.startswith("Failsafe: battery") for text in flight.texts())
        assert flight.run(30.0, until=lambda: not commander.armed)
        assert flight.command(ARM, 1.0) == REFUSED
        assert flight.texts()[-1] == "Arming denied: battery low"


def test_a_fence_of_the_scenario_causes_a_hold_and_refuses_arming_outside():
    fence = (CircleConfig(north_m=0.0, east_m=0.0, radius_m=12.0),)
    with flight_of(fence=fence, params={"GF_ACTION": 2}) as flight:
        flight.take_off(5.0)
        commander = flight.vehicle.commander
        assert flight.vehicle.monitor.breach is None
        with_sticks(flight, 0.5, x=900)
        assert commander.mode is FlightMode.POSITION
        for _ in range(200):
            with_sticks(flight, 0.096, x=900)
            if commander.failsafe:
                break
        assert commander.mode is FlightMode.HOLD
        assert flight.texts()[-1] == "Failsafe: geofence, Hold"
        assert flight.vehicle.monitor.breach is not None
        bits = common.MAV_SYS_STATUS_GEOFENCE
        assert (
            not flight.vehicle.messaging.telemetry.system.sys_status().onboard_control_sensors_health & bits
        )


def test_targets_outside_the_fence_are_refused_and_a_hold_on_its_way_out_stops():
    fence = (CircleConfig(north_m=0.0, east_m=0.0, radius_m=15.0),)
    with flight_of(fence=fence, params={"GF_ACTION": 2}) as flight:
        flight.take_off(5.0)
        flight.run(10.0, until=lambda: flight.vehicle.commander.mode is FlightMode.HOLD)
        data = flight.vehicle.flight
        lat_deg = data.state.origin_lat_deg + math.degrees(40.0 / 6_371_000.0)
        place = (NAN, lat_deg, data.state.origin_lon_deg, data.home.alt_m + 5.0)
        assert flight.command(common.MAV_CMD_DO_REPOSITION, -1.0, 1.0, 0.0, *place) == ACCEPTED
        assert flight.texts()[-1] == "Reposition is outside geofence"
        flight.run(5.0)
        assert math.hypot(*data.state.pos_ned_m[:2]) < 1.5
        flight.vehicle.parameters.set("GF_ACTION", 1.0)
        assert flight.command(common.MAV_CMD_DO_REPOSITION, -1.0, 1.0, 0.0, *place) == ACCEPTED
        assert flight.run(20.0, until=lambda: data.state.pos_ned_m[0] > 17.0)
        flight.vehicle.parameters.set("GF_ACTION", 2.0)
        assert flight.run(1.0, until=lambda: flight.vehicle.commander.failsafe)
        assert flight.vehicle.commander.mode is FlightMode.HOLD
        flight.run(8.0)
        assert data.state.pos_ned_m[0] < 28.0  # from 5 m/s it stops within some 6 m
        assert math.hypot(*data.state.vel_ned_m_s[:2]) < 0.5


def test_a_ground_station_that_is_lost():
    with flight_of(params={"NAV_DLL_ACT": 3, "COM_DL_LOSS_T": 5.0, "COM_FAIL_ACT_T": 2.0}) as flight:
        heartbeat = common.MAVLink_heartbeat_message(
            common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
        )
        commander = flight.vehicle.commander
        flight.run(12.0)
        assert flight.command(ARM, 1.0) == REFUSED
        assert flight.texts()[-1] == "Arming denied: no ground station"
        for _ in range(14):
            flight.send(heartbeat)
            flight.run(1.0)
            if not commander.armed:
                flight.command(ARM, 1.0)
                flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, NAN)
        assert commander.mode is FlightMode.HOLD
        assert not commander.failsafe
        heard_us = flight.now_us - 1_000_000
        assert flight.run(6.0, until=lambda: commander.failsafe)
        assert flight.now_us - heard_us == pytest.approx(5_000_000, abs=150_000)
        assert flight.run(2.1, until=lambda: commander.mode is FlightMode.LAND)


def test_termination_by_command_stops_the_motors_permanently():
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        assert flight.command(common.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == ACCEPTED
        assert flight.step().actuators.controls == [0.0] * 16
        assert flight.run(5.0, until=lambda: flight.height_m < 0.05)
        assert flight.command(ARM, 1.0) == DENIED
        assert flight.texts()[-1] == "Arming denied: flight was terminated"


def test_all_reasons_against_arming_are_reported_on_request():
    with Flight(vehicle_config(), gps=False) as flight:
        flight.run(3.0)
        assert flight.command(common.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
        reasons = ["GPS fix", "velocity estimate", "position estimate"]
        assert flight.texts() == [f"Arming denied: no {reason}" for reason in reasons]
        prearm = common.MAV_SYS_STATUS_PREARM_CHECK
        assert (
            not flight.vehicle.messaging.telemetry.system.sys_status().onboard_control_sensors_health & prearm
        )


def test_parameters_act_in_flight_and_are_saved_on_request():
    with flight_of() as flight:
        flight.take_off(5.0)
        vehicle = flight.vehicle
        flight.run(3.0)
        integral_m_s2 = vehicle.pilot.controller._position.integral_ned_m_s2.copy()
        hover = vehicle.pilot.controller.hover_thrust
        set_parameter(flight, "MPC_XY_P", 1.1)
        set_parameter(flight, "EKF2_GPS_V_NOISE", 0.3)
        assert vehicle.parameters.get("MPC_XY_P") == pytest.approx(1.1)
        assert vehicle.pilot.controller.hover_thrust == pytest.approx(hover, abs=1e-3)
        np.testing.assert_allclose(
            vehicle.pilot.controller._position.integral_ned_m_s2, integral_m_s2, atol=0.02
        )
        with pytest.raises(ParameterError, match="at the start"):
            vehicle.parameters.set("EKF2_GPS_DELAY", 100.0)
        before = vehicle.flight.state.pos_ned_m.copy()
        flight.run(2.0)
        assert np.abs(vehicle.flight.state.pos_ned_m - before).max() < 0.3
        flight.send(
            common.MAVLink_command_long_message(1, 1, common.MAV_CMD_PREFLIGHT_STORAGE, 0, 1.0, *[0.0] * 6)
        )
        assert flight.step().save_parameters
        assert not flight.step().save_parameters
        assert flight.command(common.MAV_CMD_PREFLIGHT_STORAGE, 2.0) == REFUSED  # not in flight
        assert vehicle.parameters.get("MPC_XY_P") == pytest.approx(1.1)
    with Flight(vehicle_config()) as flight:  # without a parameter file
        assert flight.command(common.MAV_CMD_PREFLIGHT_STORAGE, 1.0) == UNSUPPORTED
        assert flight.now_us == STEP_US


def test_parameters_are_reset_and_reported_on_the_ground():
    set_before = {"MPC_XY_P": 1.5, "BAT_CRIT_THR": 0.2, "BAT_LOW_THR": 0.25, "EKF2_GPS_DELAY": 90.0}
    with flight_of(params=set_before | {"CAL_MAG0_ROT": 2.0}) as flight:
        flight.step()
        vehicle = flight.vehicle
        assert flight.command(common.MAV_CMD_PREFLIGHT_STORAGE, 3.0) == ACCEPTED
        assert vehicle.parameters.get("CAL_MAG0_ROT") == -1.0
        assert vehicle.parameters.get("MPC_XY_P") == 1.5
        vehicle.parameters.set("CAL_MAG0_ROT", 2.0)
        flight.step()
        flight.received.clear()
        assert flight.command(common.MAV_CMD_PREFLIGHT_STORAGE, 2.0) == ACCEPTED
        names = {m.param_id for _, m in flight.received if m.get_type() == "PARAM_VALUE"}
        assert names == {*set_before, "CAL_MAG0_ROT"} - {"EKF2_GPS_DELAY"}  # can only be set at the start
        fresh = ParameterSet(Settings())
        kept = {"EKF2_GPS_DELAY", "MAV_SYS_ID"}
        assert all(vehicle.parameters.get(r.name) == fresh.get(r.name) for r in ROWS if r.name not in kept)
        assert vehicle.parameters.get("EKF2_GPS_DELAY") == 90.0
        assert vehicle.pilot.controller.hover_thrust > 0.0
        site_gauss = vehicle.config.site.magnetic_field_ned_gauss
        assert vehicle.parameters.settings.estimation.magnetic_field_ned_gauss == site_gauss


def test_sticks_for_another_vehicle_are_ignored():
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        for _ in range(3):
            flight.send(common.MAVLink_manual_control_message(99, 1000, 0, 500, 0, 0))
            flight.run(0.05)
        assert flight.vehicle.manual.sticks is None
        assert flight.vehicle.commander.mode is FlightMode.HOLD


def test_arming_requires_the_charge_of_the_parameter():
    with flight_of(params={"COM_ARM_BAT_MIN": 0.9}) as flight:
        make_ready(flight)
        flight.vehicle.parameters.set("BAT1_CAPACITY", 20.0)  # of which avionics have drawn some
        flight.run(8.0)
        assert flight.command(ARM, 1.0) == REFUSED
        assert flight.texts()[-1] == "Arming denied: battery below COM_ARM_BAT_MIN"


@pytest.mark.parametrize("broken", ["silent", "mad"])
def test_a_silent_or_invalid_inertial_sensor_invalidates_the_estimate(broken):
    """The last estimate stays constant: without accepted samples it must not be used for flight."""
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        sensors = flight.vehicle._sensors
        if broken == "silent":
            sensors.take = lambda *_: False
        else:
            flight.vehicle.estimator.on_imu = lambda sample, on_imu=flight.vehicle.estimator.on_imu: on_imu(
                structs.replace(sample, gyro_frd_rad_s=np.full(3, 1e4))
            )
        begin_us = flight.now_us
        assert flight.run(2.0, until=lambda: flight.vehicle.commander.terminated)
        # 100 ms until the sensor counts as lost, and half a second in case it is transient
        assert flight.now_us - begin_us == pytest.approx(600_000, abs=DECISION_PERIOD_US)


@pytest.mark.parametrize("action", [2, 5])
def test_the_application_yields_to_a_failsafe_and_does_not_take_off_again(action):
    """Its target is above the ceiling: it yields to the hold, and after a landing stays on the ground."""
    config = replace(
        vehicle_config(onboard=True),
        autopilot=AutopilotConfig(
            params={"GF_MAX_VER_DIST": 1.0, "GF_ACTION": action, "COM_FAIL_ACT_T": 0.0}
        ),
    )
    with Flight(config) as flight:
        vehicle = flight.vehicle
        assert flight.run(30.0, until=lambda: vehicle.commander.failsafe)
        flight.run(20.0)
        assert vehicle.app.phase is (FlightPhase.YIELDED if action == 2 else FlightPhase.LANDED)
        assert vehicle.commander.armed is (action == 2)
        assert vehicle.commander.mode is FlightMode.HOLD
        assert max(flight.height_m, 0.0) < 3.0
        armings = [armed for _, _, armed in flight.modes]
        assert sum(after and not before for before, after in pairwise(armings)) == 1

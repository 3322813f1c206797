"""Held flights: only beacons and ranging until a ground station releases them."""

from onboard_world import MODE_LOITER, SwarmWorld
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import stamp
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.onboard_config import OnboardConfig
from netsim.wire.messages import Broadcast, FtmRequest

PAIR = ((-3.0, 0.0, -8.0), (3.0, 0.0, -8.0))
HOLD = OnboardConfig(hold=True)
STATION = (255, 190)


def command(number, *, integer=False):
    """Return a command from a ground station to the application."""
    if integer:
        message = common.MAVLink_command_int_message(1, 191, 0, number, 0, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    else:
        message = common.MAVLink_command_long_message(1, 191, number, 0, *(0.0,) * 7)
    stamp(message, system=STATION[0], component=STATION[1])
    return message


def result_of(answers):
    """Return the result of the single answer, which must be addressed to the ground station."""
    (answer,) = answers
    assert (answer.target_system, answer.target_component) == STATION
    return answer.result


def test_held_uavs_send_beacons_and_no_commands_to_their_autopilots():
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=HOLD)
    world.run_until(lambda w: all(app.phase is FlightPhase.HELD for app in w.apps), limit_s=1.5)
    before = dict(world.sent)
    world.run(5.0)
    assert all(app.phase is FlightPhase.HELD for app in world.apps)
    # each sends its beacon ten times a second, and ranges to the other once
    assert world.sent[Broadcast] - before.get(Broadcast, 0) >= 2 * 5 * 9
    assert world.sent[FtmRequest] - before.get(FtmRequest, 0) >= 2 * 4
    assert all(not autopilot.commands for autopilot in world.autopilots)
    assert all(autopilot.setpoint is None for autopilot in world.autopilots)


def test_only_the_released_uav_flies():
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=HOLD)
    world.run(3.0)
    released, held = world.apps
    assert result_of(released.on_request(command(common.MAV_CMD_USER_1))) == common.MAV_RESULT_ACCEPTED
    assert result_of(released.on_request(command(common.MAV_CMD_USER_1))) == common.MAV_RESULT_ACCEPTED
    world.run_until(lambda w: w.apps[0].phase is FlightPhase.ON_STATION, limit_s=25.0)
    assert held.phase is FlightPhase.HELD
    assert not world.autopilots[1].commands
    # the other one then flies as if it had not been held
    assert result_of(held.on_request(command(common.MAV_CMD_USER_1, integer=True))) == 0
    world.run_until(lambda w: w.apps[1].phase is FlightPhase.ON_STATION, limit_s=25.0)


def test_a_release_before_the_first_position_skips_the_held_phase():
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=HOLD)
    for app in world.apps:
        app.on_request(command(common.MAV_CMD_USER_1))
    seen = set()
    world.run_until(
        lambda w: seen.add(w.apps[0].phase) or w.apps[0].phase is FlightPhase.TAKE_OFF, limit_s=6.0
    )
    assert FlightPhase.HELD not in seen


def test_other_commands_and_flights_that_are_not_held_are_unsupported():
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=HOLD)
    world.run(2.0)
    app = world.apps[0]
    assert result_of(app.on_request(command(common.MAV_CMD_USER_2))) == common.MAV_RESULT_UNSUPPORTED
    assert app.on_request(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []
    world.run(1.0)
    assert app.phase is FlightPhase.HELD
    free = SwarmWorld(places_ned_m=PAIR, seed=1).apps[0]
    assert result_of(free.on_request(command(common.MAV_CMD_USER_1))) == common.MAV_RESULT_UNSUPPORTED


def test_a_vehicle_flown_by_its_user_is_taken_over_in_the_air():
    world = SwarmWorld(places_ned_m=PAIR, seed=1, config=HOLD)
    world.run(3.0)
    autopilot = world.autopilots[0]
    autopilot.armed, autopilot.mode = True, MODE_LOITER
    world.pos[0, 2] = -6.0
    world.run(2.0)
    assert world.apps[0].phase is FlightPhase.HELD
    world.apps[0].on_request(command(common.MAV_CMD_USER_1))
    world.run_until(lambda w: w.apps[0].phase is FlightPhase.ON_STATION, limit_s=25.0)
    assert world.pos[:1, 2].max() < -6.0

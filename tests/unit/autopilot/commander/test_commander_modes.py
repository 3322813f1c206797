"""The commander as a pure state machine: granted requests, and how a flight begins and ends."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition, Reason, first_missing
from autopilot.commander.commander import Commander
from autopilot.commander.failsafe import ARMING_CAUSES, Cause
from autopilot.commander.mode_table import ModeTable, ModeTraits
from autopilot.commander.params import CommanderParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mode_registry import mode_table

ALL = sum(Condition)
MODES = mode_table()
MODES_TO_ARM_IN = [mode for mode, traits in MODES.traits.items() if traits.arms]
S = 1_000_000
STEP = 4_000


def step(commander, now_us, *, conditions=ALL, landed=True, causes=0, next_mode=None):
    return commander.update(now_us, conditions=conditions, causes=causes, landed=landed, next_mode=next_mode)


def ready(conditions=ALL, *, params=None):
    commander = Commander(params or CommanderParams(), MODES)
    step(commander, 0, conditions=conditions)
    return commander


def flying(mode):
    commander = ready()
    assert commander.arm(0) is None
    step(commander, STEP, landed=False)
    assert commander.set_mode(mode) is None
    return commander


@pytest.mark.parametrize("mode", sorted(MODES_TO_ARM_IN, key=lambda mode: mode.label))
@pytest.mark.parametrize("missing", list(Condition))
def test_a_missing_condition_refuses_arming_with_its_reason_where_needed(mode, missing):
    commander = ready()
    assert commander.set_mode(mode) is None
    step(commander, STEP, conditions=ALL & ~missing)
    if not MODES.arming_needs(mode) & missing:
        assert commander.arm(0) is None
        return
    reason = commander.arm(0)
    assert reason is first_missing(missing, 0)
    assert reason.name == f"NO_{missing.name}"
    assert reason.result == common.MAV_RESULT_TEMPORARILY_REJECTED
    assert commander.arming_refusals() == [reason]
    assert not commander.armed
    assert commander.arm(0, forced=True) is None
    assert commander.armed


@pytest.mark.parametrize("mode", sorted(MODES_TO_ARM_IN, key=lambda mode: mode.label))
def test_a_vehicle_that_is_not_armable_can_only_be_armed_by_force(mode):
    commander = ready(params=CommanderParams(armable=0))
    assert commander.set_mode(mode) is None
    assert commander.arm(0) is Reason.NOT_ARMABLE
    assert not commander.armed
    commander.params = CommanderParams()
    assert commander.arm(0) is None
    assert commander.disarm() is None
    commander.params = CommanderParams(armable=0)
    assert commander.arm(0, forced=True) is None
    assert commander.armed


def test_every_reason_against_arming_is_reported_the_most_basic_first():
    commander = ready(ALL & ~(Condition.GPS | Condition.POSITION | Condition.BARO))
    assert commander.arming_refusals() == [Reason.NO_BARO, Reason.NO_GPS, Reason.NO_POSITION]


@pytest.mark.parametrize(("cause", "reason"), ARMING_CAUSES)
def test_a_cause_refuses_arming_if_a_parameter_assigns_an_action(cause, reason):
    commander = ready()
    step(commander, STEP, causes=cause)
    depends = {Cause.GCS_LOST: {"gcs_loss_action": 0}, Cause.GEOFENCE: {"geofence_action": 1}}
    commander.params = CommanderParams(gcs_loss_action=1)
    assert commander.arm(0) is reason
    if cause in depends:
        commander.params = CommanderParams(**depends[cause])
        assert commander.arm(0) is None


def test_only_manual_modes_without_a_position_arm_without_gps():
    for mode in MODES_TO_ARM_IN:
        commander = ready()
        assert commander.set_mode(mode) is None
        step(commander, STEP, conditions=ALL & ~(Condition.GPS | Condition.POSITION | Condition.VELOCITY))
        without_place = mode in {FlightMode.ALTITUDE, FlightMode.STABILIZED}
        assert (commander.arm(0) is None) is without_place


def test_modes_that_cannot_take_off_cannot_be_armed_in():
    commander = ready()
    assert commander.set_mode(FlightMode.LAND) is None
    assert commander.arm(0) is Reason.MODE_CANNOT_ARM


@pytest.mark.parametrize("mode", [m for m in FlightMode if m not in MODES.needs] + [FlightMode.DESCEND, None])
def test_modes_that_are_not_implemented_are_denied(mode):
    commander = flying(FlightMode.HOLD)
    assert commander.set_mode(mode) is Reason.MODE_UNAVAILABLE
    assert commander.mode is FlightMode.HOLD


@pytest.mark.parametrize("armed", [False, True])
def test_offboard_needs_its_setpoints_first(armed):
    commander = ready(ALL & ~Condition.SETPOINTS)
    if armed:
        assert commander.arm(0) is None
    assert commander.set_mode(FlightMode.OFFBOARD) is Reason.NO_SETPOINTS
    step(commander, STEP)
    assert commander.set_mode(FlightMode.OFFBOARD) is None


def test_disarming_in_the_air_must_be_forced():
    commander = flying(FlightMode.HOLD)
    assert commander.disarm() is Reason.IN_AIR
    assert commander.armed
    assert commander.disarm(forced=True) is None
    assert not commander.armed


def test_takeoff_ends_in_hold():
    commander = flying(FlightMode.TAKEOFF)
    step(commander, 2 * STEP, landed=False)
    assert commander.mode is FlightMode.TAKEOFF
    step(commander, 3 * STEP, landed=False, next_mode=FlightMode.HOLD)
    assert commander.mode is FlightMode.HOLD


def test_disarms_exactly_two_seconds_after_landing():
    #  0 s armed   1 s airborne   5 s landed .................. 7 s disarmed, back in hold
    commander = ready()
    commander.arm(0)
    commander.set_mode(FlightMode.TAKEOFF)
    step(commander, 1 * S, landed=False)
    commander.set_mode(FlightMode.LAND)
    assert [n.text for n in step(commander, 5 * S)] == ["Landing detected"]
    assert step(commander, 7 * S - STEP) == ()
    assert commander.armed
    assert [n.text for n in step(commander, 7 * S)] == ["Disarmed by landing"]
    assert not commander.armed
    assert commander.mode is FlightMode.HOLD


@pytest.mark.parametrize(("limit_s", "disarmed"), [(10.0, True), (-1.0, False)])
def test_disarms_without_takeoff(limit_s, disarmed):
    commander = Commander(CommanderParams(disarm_preflight_s=limit_s), MODES)
    step(commander, 0)
    commander.arm(3 * S)
    step(commander, 13 * S - STEP)
    assert commander.armed
    step(commander, 13 * S)
    assert commander.armed is not disarmed


def test_termination_is_permanent():
    commander = flying(FlightMode.HOLD)
    commander.terminate()
    assert not commander.armed
    assert commander.arm(0) is Reason.TERMINATED
    assert commander.arm(0, forced=True) is Reason.TERMINATED
    assert commander.set_mode(FlightMode.HOLD) is Reason.TERMINATED


def test_nothing_happens_on_the_ground_while_disarmed():
    commander = ready()
    assert step(commander, 100 * S, conditions=0) == ()
    assert commander.mode is FlightMode.HOLD


@pytest.mark.parametrize("name", ["x" * 35, "Übung"])
def test_a_name_that_available_modes_cannot_carry_is_refused(name):
    with pytest.raises(ValueError, match="expected at most 34 ASCII characters"):
        ModeTraits(needs=Condition.ATTITUDE, name=name)


def test_a_mode_of_the_user_by_sticks_falls_back_as_the_manual_modes_do():
    traits = {
        **MODES.traits,
        FlightMode.EXTERNAL1: ModeTraits(needs=Condition.MANUAL, arms=True, by_sticks=True),
    }
    commander = Commander(CommanderParams(), ModeTable(traits))
    step(commander, 0)
    assert commander.set_mode(FlightMode.EXTERNAL1) is None
    assert commander.arm(0) is None
    step(commander, STEP, landed=False)
    assert commander.mode is FlightMode.EXTERNAL1
    step(commander, 2 * STEP, conditions=ALL & ~Condition.MANUAL, landed=False)
    assert (commander.mode, commander.failsafe) == (FlightMode.HOLD, True)
    step(commander, 3 * STEP, landed=False)
    assert (commander.mode, commander.failsafe) == (FlightMode.EXTERNAL1, False)


def test_an_automatic_mode_of_the_user_returns_when_a_need_is_lost_and_is_left_after_the_flight():
    needs = Condition.POSITION | Condition.GPS
    traits = {**MODES.traits, FlightMode.EXTERNAL3: ModeTraits(needs=needs, arms=True, of_one_flight=True)}
    commander = Commander(CommanderParams(), ModeTable(traits))
    step(commander, 0)
    assert commander.set_mode(FlightMode.EXTERNAL3) is None
    assert commander.arm(0) is None
    step(commander, STEP, landed=False)
    step(commander, 2 * STEP, conditions=ALL & ~Condition.GPS, landed=False)
    assert (commander.mode, commander.failsafe) == (FlightMode.RETURN, True)
    assert commander.disarm(forced=True) is None
    assert commander.mode is FlightMode.HOLD

"""The commander as a pure machine: which requests are granted, and timelines of its failsafes."""

import itertools

import pytest
from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander, CommanderParams
from autopilot.commander.conditions import (
    ARMING_NEEDS,
    FALLBACKS,
    MODE_NEEDS,
    Condition,
    Reason,
    first_missing,
)
from autopilot.mavlink.modes import FlightMode

ALL = int(ARMING_NEEDS | MODE_NEEDS[FlightMode.OFFBOARD])
S = 1_000_000
STEP = 4_000


def step(commander, now_us, *, conditions=ALL, landed=True, mode_completed=False):
    return commander.update(now_us, conditions=conditions, landed=landed, mode_completed=mode_completed)


def ready(conditions=ALL):
    commander = Commander(CommanderParams())
    step(commander, 0, conditions=conditions)
    return commander


def flying(mode):
    commander = ready()
    assert commander.arm(0) is None
    step(commander, STEP, landed=False)
    assert commander.set_mode(mode) is None
    return commander


@pytest.mark.parametrize("missing", [c for c in Condition if c in ARMING_NEEDS | MODE_NEEDS[FlightMode.HOLD]])
def test_each_missing_condition_alone_refuses_arming_and_names_itself(missing):
    commander = ready(ALL & ~missing)
    reason = commander.arm(0)
    assert reason is first_missing(missing, 0)
    assert reason.name == f"NO_{missing.name}"
    assert reason.result == common.MAV_RESULT_TEMPORARILY_REJECTED
    assert not commander.armed
    assert commander.arm(0, forced=True) is None
    assert commander.armed


def test_modes_that_cannot_take_off_cannot_be_armed_in():
    commander = ready()
    assert commander.set_mode(FlightMode.LAND) is None
    assert commander.arm(0) is Reason.MODE_CANNOT_ARM


@pytest.mark.parametrize("mode", [m for m in FlightMode if m not in MODE_NEEDS] + [FlightMode.DESCEND, None])
def test_modes_that_are_not_flown_here_are_denied(mode):
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


def test_disarming_is_for_the_ground_unless_forced():
    commander = flying(FlightMode.HOLD)
    assert commander.disarm() is Reason.IN_AIR
    assert commander.armed
    assert commander.disarm(forced=True) is None
    assert not commander.armed


def test_takeoff_ends_in_hold():
    commander = flying(FlightMode.TAKEOFF)
    step(commander, 2 * STEP, landed=False)
    assert commander.mode is FlightMode.TAKEOFF
    step(commander, 3 * STEP, landed=False, mode_completed=True)
    assert commander.mode is FlightMode.HOLD


def test_disarms_two_seconds_after_landing_and_not_before():
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
    commander = Commander(CommanderParams(disarm_preflight_s=limit_s))
    step(commander, 0)
    commander.arm(3 * S)
    step(commander, 13 * S - STEP)
    assert commander.armed
    step(commander, 13 * S)
    assert commander.armed is not disarmed


def test_lost_setpoints_hold_and_their_return_does_not_take_over():
    commander = flying(FlightMode.OFFBOARD)
    (notice,) = step(commander, 2 * STEP, conditions=ALL & ~Condition.SETPOINTS, landed=False)
    assert notice.severity == common.MAV_SEVERITY_CRITICAL
    assert notice.text == "Failsafe: no offboard setpoints, Hold"
    assert (commander.mode, commander.failsafe) == (FlightMode.HOLD, True)
    assert step(commander, 3 * STEP, landed=False) == ()
    assert commander.mode is FlightMode.HOLD
    assert commander.set_mode(FlightMode.OFFBOARD) is None
    assert not commander.failsafe


@pytest.mark.parametrize("mode", [FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.LAND])
def test_without_position_the_vehicle_descends(mode):
    commander = flying(mode)
    step(commander, 2 * STEP, conditions=ALL & ~(Condition.POSITION | Condition.VELOCITY), landed=False)
    assert commander.mode is FlightMode.DESCEND
    assert (
        step(commander, 3 * STEP, conditions=0, landed=False) == ()
    )  # nothing better is left, and it is said once


@pytest.mark.parametrize("mode", list(FALLBACKS))
def test_after_any_loss_the_mode_has_what_it_needs_or_is_descend(mode):
    flags = [c for c in Condition if c not in ARMING_NEEDS]
    for lost in itertools.chain.from_iterable(
        itertools.combinations(flags, n) for n in range(len(flags) + 1)
    ):
        commander = ready()
        commander.arm(0)
        commander.mode = mode
        conditions = ALL & ~sum(lost)
        step(commander, STEP, conditions=conditions, landed=False)
        assert commander.mode is FlightMode.DESCEND or not MODE_NEEDS[commander.mode] & ~conditions
        assert commander.mode is mode or commander.failsafe


def test_nothing_happens_on_the_ground_while_disarmed():
    commander = ready()
    assert step(commander, 100 * S, conditions=0) == ()
    assert commander.mode is FlightMode.HOLD

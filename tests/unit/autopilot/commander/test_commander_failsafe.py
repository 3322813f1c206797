"""Failsafes as timelines: causes over time, and the resulting flight modes."""

import itertools

import pytest
from msgspec.structs import replace

from autopilot.commander.arming_checks import Condition, Reason
from autopilot.commander.commander import Commander
from autopilot.commander.failsafe import ROWS, Action, Cause, Failsafe, feasible
from autopilot.commander.params import CommanderParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.mode_registry import mode_table

ALL = sum(Condition)
MODES = mode_table()
PLACE = int(Condition.POSITION | Condition.VELOCITY)
STEP_US = 100_000
HOLD, RETURN, LAND, DESCEND = FlightMode.HOLD, FlightMode.RETURN, FlightMode.LAND, FlightMode.DESCEND
OFFBOARD, MISSION, POSITION = FlightMode.OFFBOARD, FlightMode.MISSION, FlightMode.POSITION


class Timeline:
    """A vehicle in flight since 0 s; `until` runs to a time with causes present and conditions lost."""

    def __init__(self, mode=HOLD, *, causes=0, **params):
        self.commander = Commander(CommanderParams(**params), MODES)
        self.now_us = -10 * STEP_US
        self.seen = []
        """(seconds, mode or ``off``) of each change"""
        self.texts = []
        self._step(causes=causes)
        assert self.commander.arm(self.now_us, forced=True) is None
        assert self.commander.set_mode(mode) is None
        while self.now_us < 0:
            self._step(causes=causes)
        self.texts.clear()

    def _step(self, *, causes=0, lost=0):
        self.now_us += STEP_US
        notices = self.commander.update(self.now_us, conditions=ALL & ~lost, causes=causes, landed=False)
        self.texts += [(self.now_us / 1e6, notice.text) for notice in notices]
        flown = self.commander.mode if self.commander.armed else "off"
        if not self.seen or self.seen[-1][1] is not flown:
            self.seen.append((self.now_us / 1e6, flown))

    def until(self, seconds, *, causes=0, lost=0):
        while self.now_us < round(seconds * 1e6):
            self._step(causes=causes, lost=lost)
        return self

    def choose(self, mode):
        assert self.commander.set_mode(mode) is None
        return self

    @property
    def modes(self):
        """Changes after 0 s."""
        return [(t, mode) for t, mode in self.seen if t > 0]


LINKS = {1: (HOLD,), 2: (HOLD, RETURN), 3: (HOLD, LAND), 5: ("off",), 6: ("off",)}
"""NAV_DLL_ACT and NAV_RCL_ACT: the successive modes, COM_FAIL_ACT_T apart."""


@pytest.mark.parametrize(
    ("cause", "field"),
    [(Cause.GCS_LOST, "gcs_loss_action"), (Cause.MANUAL_LOST, "manual_loss_action")],
)
@pytest.mark.parametrize(("value", "modes"), LINKS.items())
def test_a_lost_link(cause, field, value, modes):
    #  0 s ... 2.0 s silence ....... 2.1 s hold ........ 7.1 s return or land
    flight = Timeline(MISSION, **{field: value}).until(2.0).until(12.0, causes=cause)
    times = [2.1, 7.1]
    assert flight.modes == list(zip(times, modes, strict=False))
    assert flight.commander.terminated is (value == 5)


@pytest.mark.parametrize("field", ["gcs_loss_action", "manual_loss_action"])
def test_a_lost_link_without_an_action(field):
    cause = Cause.GCS_LOST if field == "gcs_loss_action" else Cause.MANUAL_LOST
    assert Timeline(MISSION, **{field: 0}).until(20.0, causes=cause).modes == []


@pytest.mark.parametrize(("mode", "bit"), [(MISSION, 1), (HOLD, 2), (OFFBOARD, 4)])
def test_modes_excepted_from_link_loss_fly_on(mode, bit):
    params = {"gcs_loss_action": 3, "manual_loss_action": 3}
    both = Cause.GCS_LOST | Cause.MANUAL_LOST
    excepted = Timeline(mode, gcs_loss_except=bit, manual_loss_except=bit, **params)
    assert excepted.until(20.0, causes=both).modes == []
    others = Timeline(mode, gcs_loss_except=7 - bit, manual_loss_except=7 - bit, **params)
    assert others.until(20.0, causes=both).modes[-1][1] is LAND


def test_a_ground_station_that_is_back_does_not_end_the_failsafe():
    flight = Timeline(MISSION, gcs_loss_action=2).until(8.0, causes=Cause.GCS_LOST).until(20.0)
    assert flight.modes == [(0.1, HOLD), (5.1, RETURN)]
    flight.choose(MISSION).until(25.0)
    assert flight.modes[-1] == (20.1, MISSION)
    assert not flight.commander.failsafe


def test_manual_control_lost_before_arming_is_ignored_until_it_was_back():
    flight = Timeline(MISSION, causes=Cause.MANUAL_LOST, manual_loss_action=3)
    assert flight.until(10.0, causes=Cause.MANUAL_LOST).modes == []
    flight.until(11.0)
    assert flight.until(12.0, causes=Cause.MANUAL_LOST).modes == [(11.1, HOLD)]


@pytest.mark.parametrize(
    ("value", "mode"),
    [(0, POSITION), (1, FlightMode.ALTITUDE), (2, FlightMode.STABILIZED), (3, RETURN), (4, LAND), (5, HOLD),
     (6, "off"), (7, "off")],
)  # fmt: skip
def test_lost_offboard_setpoints(value, mode):
    flight = Timeline(OFFBOARD, offboard_loss_action=value).until(1.0)
    flight.until(3.0, lost=Condition.SETPOINTS)
    assert flight.modes == [(1.1, mode)]
    assert flight.until(6.0).modes == [(1.1, mode)]  # new setpoints do not restore offboard
    assert flight.commander.terminated is (value == 6)


@pytest.mark.parametrize("value", [0, 1, 2, 5])
def test_lost_offboard_setpoints_without_manual_control_hold(value):
    lost = Condition.SETPOINTS | Condition.MANUAL
    assert Timeline(OFFBOARD, offboard_loss_action=value).until(1.0, lost=lost).modes == [(0.1, HOLD)]


@pytest.mark.parametrize("mode", [HOLD, MISSION, RETURN, LAND, OFFBOARD, FlightMode.TAKEOFF])
def test_gps_loss_warns_and_a_lost_position_descends_until_it_is_back(mode):
    #  2 s no fix .......... 7 s no position, descend .......... 12 s both back, the selected mode again
    flight = Timeline(mode).until(2.0).until(7.0, causes=Cause.GPS_LOST)
    assert flight.texts == [(2.1, "Warning: GPS lost")]
    flight.until(12.0, causes=Cause.GPS_LOST, lost=PLACE).until(14.0)
    assert flight.modes == [(7.1, DESCEND), (12.1, mode)]


@pytest.mark.parametrize(("value", "modes"), [(1, (HOLD, RETURN)), (2, (HOLD, LAND)), (3, ("off",))])
def test_gps_loss_while_the_position_is_still_valid(value, modes):
    flight = Timeline(MISSION, gps_loss_action=value).until(9.0, causes=Cause.GPS_LOST)
    assert flight.modes == list(zip([0.1, 5.1], modes, strict=False))


@pytest.mark.parametrize(
    ("value", "critical", "empty"),
    [(0, None, None), (1, RETURN, RETURN), (2, LAND, LAND), (3, RETURN, LAND)],
)
def test_battery(value, critical, empty):
    #  1 s low: a warning ...... 2 s critical: hold, 5 s later the action ...... 20 s empty
    flight = Timeline(MISSION, low_battery_action=value).until(1.0).until(2.0, causes=Cause.BATTERY_LOW)
    assert flight.texts == [(1.1, "Warning: battery low")]
    flight.until(20.0, causes=Cause.BATTERY_CRITICAL)
    assert flight.modes == ([(2.1, HOLD), (7.1, critical)] if critical else [])
    flight.until(30.0, causes=Cause.BATTERY_EMERGENCY)
    if empty is None:
        assert flight.texts[-1] == (20.1, "Warning: battery empty")
    else:
        assert flight.commander.mode is empty
        assert len(flight.modes) == (2 if empty is critical else 3)


def test_a_battery_low_at_arming_is_ignored_until_it_gets_worse():
    flight = Timeline(MISSION, causes=Cause.BATTERY_CRITICAL, low_battery_action=2)
    assert flight.until(10.0, causes=Cause.BATTERY_CRITICAL).modes == []
    assert flight.until(11.0, causes=Cause.BATTERY_EMERGENCY).modes == [(10.1, HOLD)]


@pytest.mark.parametrize(
    ("value", "modes"),
    [(0, ()), (1, ()), (2, (HOLD,)), (3, (HOLD, RETURN)), (4, ("off",)), (5, (HOLD, LAND))],
)
def test_geofence(value, modes):
    flight = Timeline(MISSION, geofence_action=value).until(10.0, causes=Cause.GEOFENCE)
    assert flight.modes == list(zip([0.1, 5.1], modes, strict=False))
    assert bool(flight.texts) is (value > 0)


def test_the_pilot_can_fly_out_of_a_geofence_hold():
    flight = Timeline(MISSION).until(2.0, causes=Cause.GEOFENCE)
    assert flight.commander.failsafe
    flight.choose(RETURN).until(5.0, causes=Cause.GEOFENCE)
    assert flight.modes == [(0.1, HOLD), (2.1, RETURN)]
    assert flight.texts[-1] == (2.1, "Pilot took over, Return")
    assert not flight.commander.failsafe


def test_the_pilot_takes_over_during_the_delay_and_until_the_next_failsafe():
    flight = Timeline(MISSION, low_battery_action=2, gcs_loss_action=3).until(
        2.0, causes=Cause.BATTERY_CRITICAL
    )
    flight.choose(MISSION).until(20.0, causes=Cause.BATTERY_CRITICAL)
    assert flight.modes == [(0.1, HOLD), (2.1, MISSION)]
    flight.until(30.0, causes=Cause.BATTERY_CRITICAL | Cause.GCS_LOST)
    assert flight.commander.mode is LAND


@pytest.mark.parametrize(
    ("value", "modes"), [(0, ()), (1, (HOLD,)), (2, (HOLD, LAND)), (3, (HOLD, RETURN)), (4, ("off",))]
)
def test_motor_failure(value, modes):
    flight = Timeline(MISSION, motor_failure_action=value).until(10.0, causes=Cause.MOTOR_FAILED)
    assert flight.modes == list(zip([0.1, 5.1], modes, strict=False))


def test_estimator_failure_descends_and_without_an_attitude_the_motors_stop():
    flight = Timeline(MISSION).until(3.0, causes=Cause.ESTIMATOR_FAILED, lost=PLACE)
    assert flight.modes == [(0.1, DESCEND)]
    assert flight.texts == [(0.1, "Failsafe: estimator failed, Descend")]
    flight.until(4.0, causes=Cause.ESTIMATOR_FAILED, lost=PLACE | Condition.ATTITUDE | Condition.HEIGHT)
    assert flight.modes == [(0.1, DESCEND), (3.6, "off")]  # after half a second, in case it is transient
    assert flight.commander.terminated
    assert flight.commander.arm(flight.now_us, forced=True) is Reason.TERMINATED


@pytest.mark.parametrize(("breaker", "modes"), [(121_212, []), (0, [(10.1, "off")])])
def test_tipping_over_in_flight(breaker, modes):
    flight = Timeline(MISSION, termination_breaker=breaker).until(10.0)
    assert flight.until(11.0, causes=Cause.TIPPED_OVER).modes == modes
    assert flight.commander.terminated is bool(modes)


def test_tipping_over_at_take_off_disarms_only():
    # armed at -0.9 s: 1 s (spool-up) and 3 s more count as the take-off
    flight = Timeline(FlightMode.TAKEOFF).until(2.0).until(2.5, causes=Cause.TIPPED_OVER)
    assert flight.modes == [(2.1, "off")]
    assert not flight.commander.terminated


def test_the_most_severe_of_several_actions_is_executed_and_reported():
    flight = Timeline(MISSION, low_battery_action=1, geofence_action=2, motor_failure_action=4)
    flight.until(6.0, causes=Cause.GEOFENCE | Cause.BATTERY_CRITICAL)
    assert flight.modes == [(0.1, HOLD), (5.1, RETURN)]
    assert flight.texts[0][1] == "Failsafe: battery critical, Hold, Return in 5 s"
    flight.until(7.0, causes=Cause.GEOFENCE | Cause.MOTOR_FAILED)
    assert flight.texts[-1][1] == "Failsafe: motor failure, flight terminated"


def test_a_transient_loss_of_the_attitude_does_not_end_the_flight():
    flight = Timeline(MISSION).until(1.0).until(1.4, lost=Condition.ATTITUDE).until(2.0)
    assert flight.modes == [(1.1, DESCEND), (1.5, MISSION)]
    # the half second starts again with the next
    flight.until(2.4, lost=Condition.ATTITUDE).until(2.5).until(2.9, lost=Condition.ATTITUDE).until(3.0)
    assert flight.commander.mode is MISSION


def test_every_warning_is_reported_also_during_a_failsafe():
    flight = Timeline(MISSION).until(1.0, causes=Cause.BATTERY_LOW)
    flight.until(2.0, causes=Cause.BATTERY_LOW | Cause.MOTOR_FAILED)
    flight.until(3.0, causes=Cause.BATTERY_LOW | Cause.MOTOR_FAILED | Cause.GEOFENCE)
    flight.until(4.0, causes=Cause.BATTERY_LOW | Cause.GEOFENCE | Cause.GPS_LOST).until(5.0)
    assert flight.texts == [
        (0.1, "Warning: battery low"),
        (1.1, "Warning: motor failure"),
        (2.1, "Failsafe: geofence, Hold"),
        (3.1, "Warning: GPS lost"),
    ]


def test_a_failsafe_after_a_takeover_acts_again_when_its_cause_reappears():
    #  0 s outside: hold ... 2 s the pilot flies in ... 4 s inside ... 8 s outside again: hold
    flight = Timeline(MISSION).until(2.0, causes=Cause.GEOFENCE).choose(POSITION)
    flight.until(4.0, causes=Cause.GEOFENCE).until(8.0).until(9.0, causes=Cause.GEOFENCE)
    assert flight.modes == [(0.1, HOLD), (2.1, POSITION), (8.1, HOLD)]


def test_a_takeover_is_only_reported_if_there_was_one():
    causes = Cause.ESTIMATOR_FAILED | Cause.BATTERY_LOW
    flight = Timeline(MISSION).until(2.0, causes=causes, lost=PLACE).until(3.0, causes=Cause.BATTERY_LOW)
    assert [text for _, text in flight.texts] == [
        "Warning: battery low",
        "Failsafe: estimator failed, Descend",
        "Failsafe over, Mission",
    ]


def test_lost_setpoints_end_offboard_although_the_position_was_lost_first():
    lost = Condition.POSITION | Condition.VELOCITY
    flight = Timeline(OFFBOARD).until(1.0, lost=lost).until(2.0, lost=lost | Condition.SETPOINTS)
    flight.until(3.0, lost=Condition.SETPOINTS).until(4.0)
    assert flight.commander.mode is POSITION  # COM_OBL_RC_ACT 0, with manual control present


def test_a_vehicle_landed_by_a_descent_does_not_take_off_again():
    flight = Timeline(MISSION).until(2.0, causes=Cause.ESTIMATOR_FAILED, lost=PLACE)
    commander = flight.commander
    for causes, lost in ((Cause.ESTIMATOR_FAILED, PLACE), (0, 0)):
        flight.now_us += STEP_US
        commander.update(flight.now_us, conditions=ALL & ~lost, causes=causes, landed=True)
    assert (commander.mode, commander.failsafe, commander.armed) == (HOLD, False, True)


def test_on_the_ground_a_lack_of_feasible_modes_only_disarms():
    flight = Timeline(MISSION)
    flight.commander.update(flight.now_us + STEP_US, conditions=0, landed=True)
    assert not flight.commander.armed
    assert not flight.commander.terminated


def test_causes_without_an_action_are_not_processed():
    """In a swarm there is normally no ground station, and NAV_DLL_ACT is 0: it must take almost no time."""
    failsafe = Failsafe(MODES)
    args = {"params": CommanderParams(), "conditions": ALL, "mode": MISSION, "armed": True, "landed": False}
    for now_us in (0, STEP_US):
        failsafe.update(now_us, causes=Cause.GCS_LOST, mode_chosen=False, **args)
    assert failsafe._active == {}


def test_a_landing_vehicle_does_not_return():
    assert Timeline(LAND, low_battery_action=1).until(20.0, causes=Cause.BATTERY_CRITICAL).modes == []


def test_without_a_delay_the_action_is_immediate():
    flight = Timeline(MISSION, low_battery_action=2, action_delay_s=0.0)
    assert flight.until(1.0, causes=Cause.BATTERY_CRITICAL).modes == [(0.1, LAND)]


def test_no_hold_before_an_action_without_a_position():
    flight = Timeline(FlightMode.ALTITUDE, low_battery_action=2)
    flight.until(1.0, causes=Cause.BATTERY_CRITICAL, lost=PLACE)
    assert flight.modes == [(0.1, DESCEND)]


def test_a_changed_parameter_acts_on_an_active_failsafe():
    flight = Timeline(MISSION, geofence_action=2).until(3.0, causes=Cause.GEOFENCE)
    flight.commander.params = replace(flight.commander.params, geofence_action=5)
    assert flight.until(9.0, causes=Cause.GEOFENCE).commander.mode is LAND


def test_the_next_flight_starts_without_the_failsafes_of_the_last():
    flight = Timeline(MISSION, gcs_loss_action=3).until(10.0, causes=Cause.GCS_LOST)
    flight.commander.disarm(forced=True)
    flight.until(11.0)
    assert flight.commander.mode is HOLD
    assert flight.commander.arm(flight.now_us) is None
    assert flight.until(20.0).modes[-1][1] is HOLD


def test_manual_modes_fall_back_to_modes_with_fewer_needs():
    flight = Timeline(POSITION).until(1.0, lost=PLACE)
    flight.until(2.0, lost=PLACE | Condition.HEIGHT).until(3.0)
    assert flight.modes == [(0.1, FlightMode.ALTITUDE), (1.1, FlightMode.STABILIZED), (2.1, POSITION)]


def test_the_mode_in_flight_always_has_its_needs_met_or_the_motors_are_off():
    for mode, count in itertools.product(MODES.needs, range(4)):
        if mode is DESCEND:
            continue
        for lost in itertools.combinations(list(Condition), count):
            flight = Timeline(mode, manual_loss_action=0).until(1.0, lost=sum(lost))
            if flight.commander.armed:
                assert not MODES.needs[flight.commander.mode] & sum(lost)
            else:
                assert Condition.ATTITUDE in lost


def test_every_value_of_every_parameter_has_a_response_or_no_effect():
    for row in ROWS:
        for value, response in row.responses.items():
            if row.field:
                replace(CommanderParams(), **{row.field: value})
            assert isinstance(response.action, Action)
        assert (row.parameter is None) is (not row.field)


def test_the_chain_of_feasible_actions():
    assert feasible(Action.POSITION, ALL, MODES) is Action.POSITION
    assert feasible(Action.POSITION, ALL & ~Condition.MANUAL, MODES) is Action.HOLD
    assert feasible(Action.HOLD, ALL & ~Condition.POSITION, MODES) is Action.DESCEND
    assert feasible(Action.HOLD, 0, MODES) is Action.TERMINATE
    assert feasible(Action.WARN, 0, MODES) is Action.WARN


def test_nothing_is_decided_on_the_ground():
    failsafe = Failsafe(MODES)
    decision = failsafe.update(
        0,
        params=CommanderParams(),
        causes=sum(Cause),
        conditions=0,
        mode=HOLD,
        armed=False,
        landed=True,
        mode_chosen=False,
    )
    assert decision.action is Action.NONE

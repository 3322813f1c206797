"""Periods of setpoints, heartbeats and beacons at different loop periods of the application."""

import numpy as np
import pytest
from onboard_world import ALONE, STEP_US, phase_is, world
from pymavlink.dialects.v20 import common

from autopilot.mavlink.local_messages import PositionTarget
from autopilot.onboard.formation.guidance import SETPOINT_PERIOD_US
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.formation_plan import FormationPlan, RacetrackMotion
from autopilot.onboard.programs import NOTHING
from autopilot.parameters.onboard_config import OnboardConfig

GPS = OnboardConfig(localisation="gps")


def test_setpoints_keep_their_period_before_and_in_offboard():
    w = world(ALONE)
    w.run_until(phase_is(FlightPhase.TAKE_OFF), limit_s=5.0)
    received = []
    autopilot = w.autopilots[0]
    original = autopilot.on_message
    autopilot.on_message = lambda msg, now_us: (
        received.append((now_us, msg)) if msg.get_type() == "SET_POSITION_TARGET_LOCAL_NED" else None,
        original(msg, now_us),
    )[1]
    w.run(5.0)
    assert np.all(np.abs(np.diff([now_us for now_us, _ in received]) - SETPOINT_PERIOD_US) <= STEP_US)
    mask = {m.type_mask for _, m in received}
    assert mask == {
        0b1101_1100_0000
    }  # position and velocity are used; acceleration, yaw and yaw rate are not


@pytest.mark.parametrize("loop_us", [4_000, 20_000, 40_000])
def test_items_due_before_the_next_iteration_are_sent_with_their_own_time(loop_us):
    """Ten beacons a second, a period apart except for their jitter, at any loop period."""
    w = world(ALONE, loop_us=loop_us)
    w.run_until(phase_is(FlightPhase.TAKE_OFF), limit_s=5.0)
    app, beacons_us = w.apps[0], []
    on_timer = app.on_timer

    def spy(now_us):
        out = on_timer(now_us)
        assert all(now_us <= item.at_us < now_us + loop_us for item in out.radio)
        beacons_us.extend(item.at_us for item in out.radio)
        return out

    app.on_timer = spy
    w.run(5.0)
    between_us = np.diff(beacons_us)
    assert len(between_us) >= 48
    assert np.all(np.abs(between_us - 100_000) <= 4_000)  # twice 2 %


def test_a_step_before_the_deadline_has_nothing_to_send():
    """An application that is forced to process every step sends the same at the same times."""
    sent = []
    for always in (False, True):
        w = world(ALONE)
        app, outputs = w.apps[0], []
        on_timer = app.on_timer

        def spy(now_us, app=app, on_timer=on_timer, outputs=outputs, always=always):
            if always:
                app.application._due_us = 0
            out = on_timer(now_us)
            if out is not NOTHING:
                sent_messages = [m if isinstance(m, PositionTarget) else m.to_dict() for m in out.mavlink]
                outputs.append((now_us, sent_messages, out.radio))
            return out

        app.on_timer = spy
        w.run(12.0)
        assert app.phase is FlightPhase.ON_STATION
        sent.append(outputs)
    assert sent[0] == sent[1]
    assert len(sent[0]) < 0.2 * 12e6 / STEP_US


def test_heartbeats_report_the_phase_at_1_hz_and_at_every_change():
    w = world(ALONE)
    beats = []
    app = w.apps[0]
    on_timer = app.on_timer

    def spy(now_us):
        out = on_timer(now_us)
        beats.extend((now_us, m.custom_mode, m.type) for m in out.mavlink if m.get_type() == "HEARTBEAT")
        return out

    app.on_timer = spy
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    assert {kind for _, _, kind in beats} == {common.MAV_TYPE_ONBOARD_CONTROLLER}
    assert [phase for k, (_, phase, _) in enumerate(beats) if k == 0 or beats[k - 1][1] != phase] == [
        0,
        2,
        3,
        4,
        5,
    ]
    assert max(np.diff([now_us for now_us, _, _ in beats])) <= 1_000_000


def test_beacons_are_a_period_apart_with_jitter_and_stations_have_different_phases():
    w = world(config=GPS)
    times_us = [[], []]
    transmit = w._transmit
    w._transmit = lambda i, item: (times_us[i].append(item.at_us), transmit(i, item))[1]
    w.run(10.0)
    for own_us in times_us:
        gaps_us = np.diff(own_us)
        assert np.all(np.abs(gaps_us - 100_000) <= 2 * 2_000)  # two shifts of at most 2 % of the period
        assert np.std(gaps_us) > 500
        assert len({at_us % STEP_US for at_us in own_us}) > 50
    assert abs(times_us[0][10] - times_us[1][10]) % 100_000 > STEP_US


@pytest.mark.parametrize("loop_us", [4_000, 12_000, 20_000, 28_000, 36_000, 40_000])
def test_setpoints_follow_a_moving_plan_at_any_loop_period(loop_us):
    """The intervals of setpoints then differ, and each is the plan's half a period later."""
    motion = RacetrackMotion(speed_m_s=3.0, length_m=30.0, radius_m=25.0)
    w = world(ALONE, config=GPS, loop_us=loop_us, motion=motion)
    w.run_until(phase_is(FlightPhase.ON_STATION), limit_s=20.0)
    w.run(5.0)  # the motion has begun, and the reference has joined it
    app, plan, misses_m, apart_m_s2 = w.apps[0], FormationPlan(ALONE, 0.0, motion), [], []
    on_timer = app.on_timer

    def spy(now_us):
        out = on_timer(now_us)
        if any(isinstance(message, PositionTarget) for message in out.mavlink):
            since_s = (now_us - app.application._guidance.start.start_us) * 1e-6
            target = plan.own(0, since_s + 0.5 * SETPOINT_PERIOD_US * 1e-6)
            reference = app.application._guidance._reference
            misses_m.append(np.abs(reference.pos_ned_m - target.pos_ned_m).max())
            apart_m_s2.append(np.abs(reference.acc_ned_m_s2 - target.acc_ned_m_s2).max())
        return out

    app.on_timer = spy
    w.run(25.0)  # a straight and the turn after it
    assert len(misses_m) > 400
    assert max(misses_m) < 1e-6
    assert max(apart_m_s2) < 1e-6

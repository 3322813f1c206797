"""A policy in a run: the observations of an environment, when it begins, what is refused."""

import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.onboard.context import Context, Radio
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import Devices, Site
from harness.env.application import SLOW_M_S, EnvApplication
from harness.env.policy import HOVER_S, PolicyApplication, PolicyPhase
from harness.env.settings import EnvSettings, limited
from netsim.wire.messages import Delivery, FtmResult

LOOP_US = 40_000
AGENTS = 3
HOVER_LOOPS = round(HOVER_S * 1e6 / LOOP_US)
PLACES_NED_M = np.array([(0.0, 0.0, -4.0), (5.0, 0.0, -4.0), (10.0, 0.0, -4.0)])


class Autopilot(SimpleNamespace):
    """The members of `AutopilotClient` that are used, with a position that the test sets."""

    def __init__(self):
        super().__init__(follows=True, pos_ned_m=(5.0, 0.0, -4.0), vel_ned_m_s=(0.0, 0.0, 0.0), setpoints=[])

    def take_off(self, height_m):
        pass

    def fly(self, **setpoint):
        self.setpoints.append(setpoint)


def started(application):
    context = Context(
        uav=1, plan=FormationPlan(PLACES_NED_M, 0.0, None), site=Site(), devices=Devices(),
        loop_period_us=LOOP_US, rng=np.random.default_rng(1),
        radio=Radio(station=1, stations=AGENTS, loop_us=LOOP_US), autopilot=Autopilot(), autopilot_kind="own",
    )  # fmt: skip
    application.start(context)
    return application


class Turning(PolicyApplication):
    """Stores its observations; its actions depend on them."""

    def start(self, context):
        super().start(context)
        self.observed = []

    def act(self, observation):
        self.observed.append(observation)
        return np.sin(observation.sum() + np.arange(len(self.action_names)))


def run(application, now_us, items=()):
    application.on_radio(items, now_us)
    application._context.radio.now_us = now_us
    application.on_timer(now_us)
    return application._context.radio.take()


def hovered(policy):
    """Run the policy until it has hovered for its time; return the time of its next iteration."""
    for loop in range(1, HOVER_LOOPS + 1):
        run(policy, loop * LOOP_US)
        assert policy.status().phase is PolicyPhase.APPROACHING
    return (HOVER_LOOPS + 1) * LOOP_US


@st.composite
def received(draw):
    """Return the events of one iteration: the own velocity, and a beacon, a range, both or neither."""
    number = st.floats(-60.0, 60.0, width=32)
    source, time_us = draw(st.sampled_from((0, 2))), draw(st.integers(0, LOOP_US - 1))
    state = draw(st.tuples(*[number] * 7))
    return draw(st.tuples(number, number, number)), (source, time_us, state), draw(st.integers(0, 3))


@settings(deadline=None, max_examples=50)
@given(st.lists(received(), min_size=2, max_size=12), st.sampled_from(("scheduled", "chosen")))
def test_a_policy_observes_and_sends_what_it_does_in_an_environment(events, radio):
    """An environment reads the observation after an iteration, and sets the action before the next one."""
    own = EnvSettings(message_size=1, radio=radio, beacon_period_s=0.08)
    policy, agent = started(Turning(own)), started(EnvApplication(own))
    now_us = hovered(policy)
    for loop in range(1, HOVER_LOOPS + 1):
        run(agent, loop * LOOP_US)
    for vel_ned_m_s, (source, time_us, state), kind in events:
        observed = limited(agent.observation(), own.observation_bounds(AGENTS))
        agent.action = np.sin(observed.sum() + np.arange(len(own.action_names())))
        items = []
        received_ns = (now_us - LOOP_US + time_us) * 1_000
        if kind & 1:
            payload = struct.pack("<7f", *state)
            items.append(
                Delivery(source=source, seq=0, received_ns=received_ns, rssi_dbm=-60.0, payload=payload)
            )
        if kind & 2:
            items.append(
                FtmResult(
                    peer=source, seq=0, status="ok", measured_ns=received_ns, ended_ns=received_ns,
                    distance_m=abs(state[0]), distance_std_m=0.1, rssi_dbm=-60.0, round_trips=8,
                    measurements=8,
                )
            )  # fmt: skip
        assert run(policy, now_us, items) == run(agent, now_us, items)
        np.testing.assert_array_equal(policy.observed[-1], observed)
        for each in (policy, agent):  # from the next iteration on
            each._context.autopilot.vel_ned_m_s = vel_ned_m_s
        now_us += LOOP_US
    assert policy.status().phase is PolicyPhase.FOLLOWING
    assert policy._context.autopilot.setpoints == agent._context.autopilot.setpoints


def test_the_time_of_hovering_begins_anew_when_the_uav_moves():
    policy = started(Turning(EnvSettings()))
    autopilot = policy._context.autopilot
    for loop in range(1, HOVER_LOOPS):
        run(policy, loop * LOOP_US)
    autopilot.vel_ned_m_s = (2.0 * SLOW_M_S, 0.0, 0.0)
    run(policy, HOVER_LOOPS * LOOP_US)
    autopilot.vel_ned_m_s = (0.0, 0.0, 0.0)
    for loop in range(HOVER_LOOPS + 1, 2 * HOVER_LOOPS + 1):
        run(policy, loop * LOOP_US)
        assert not policy.observed
        assert autopilot.setpoints[-1] == {"pos_ned_m": tuple(PLACES_NED_M[1])}
    run(policy, (2 * HOVER_LOOPS + 1) * LOOP_US)
    assert len(policy.observed) == 1
    assert "vel_ned_m_s" in autopilot.setpoints[-1]


@pytest.mark.parametrize("action", [(0.0, 0.0), (0.0, 0.0, math.nan), np.zeros((3, 1))])
def test_a_wrong_action_names_the_uav_and_what_is_expected(action):
    class Wrong(PolicyApplication):
        def act(self, _observation):
            return action

    policy = started(Wrong(EnvSettings()))
    now_us = hovered(policy)
    with pytest.raises(ValueError, match=r"^env: action of uav_1: .*; expected 3 numbers$"):
        run(policy, now_us)

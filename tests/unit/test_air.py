"""When the emulator is asked to go on, what it is told, and what its answers mean."""

from types import SimpleNamespace

import numpy as np
import pytest

from harness.air import LONGEST_REST_US, Air, RadioSilent
from netsim.hosted import LEAD_US
from netsim.wire.messages import Advance, Advanced, decode, encode, unpack_rows

STEP_US = 4_000
POS_NED_M = np.arange(6.0).reshape(2, 3)
VEL_NED_M_S = -0.5 * POS_NED_M
Q_NED_FRD = np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0]])
TRUTH = SimpleNamespace(pos_ned_m=POS_NED_M, vel_ned_m_s=VEL_NED_M_S, q_ned_frd=Q_NED_FRD)


class Emulator:
    """Takes the place of transport, asker and pending question; answers with what the test puts in."""

    def __init__(self):
        self.asked = []
        self.answers = []

    def asker(self, _key, *, timeout_s):
        assert timeout_s > 0.0
        return self

    def ask(self, payload):
        self.asked.append(decode(Advance, payload))
        return self

    def answer(self):
        answer = self.answers.pop(0)
        return None if answer is None else encode(answer)


@pytest.fixture
def emulator():
    return Emulator()


@pytest.fixture
def air(emulator):
    return Air(emulator, "test")


def advanced(to_us, *, quiet_until_us=0, unresponsive=()):
    return Advanced(to_us=to_us, quiet_until_us=quiet_until_us, unresponsive=unresponsive)


def step(air, emulator, time_us, **answer):
    """The step that begins at ``time_us``, if it is not skipped."""
    emulator.answers = [advanced(time_us + STEP_US, **answer)]
    air.begin(time_us, STEP_US, TRUTH, ())
    return air.end()


def test_a_quiet_air_is_left_alone_until_its_time_or_until_somebody_speaks(air, emulator):
    step(air, emulator, 0, quiet_until_us=13_000)
    for time_us in (4_000, 8_000):
        step(air, emulator, time_us)
    assert [request.to_us for request in emulator.asked] == [4_000]
    step(air, emulator, 12_000, quiet_until_us=10**9)
    air.handed_over()
    step(air, emulator, 16_000, quiet_until_us=10**9)
    step(air, emulator, 20_000)
    assert [request.to_us for request in emulator.asked] == [4_000, 16_000, 20_000]
    assert [request.at_us for request in emulator.asked] == [0, 12_000, 16_000]
    assert [request.release_us for request in emulator.asked] == [8_000, 20_000, 24_000]
    (pos_ned_m,) = {request.pos_ned_m for request in emulator.asked}
    (vel_ned_m_s,) = {request.vel_ned_m_s for request in emulator.asked}
    assert np.array_equal(unpack_rows(pos_ned_m, stations=2, columns=3), POS_NED_M)
    (q_ned_frd,) = {request.q_ned_frd for request in emulator.asked}
    assert np.array_equal(unpack_rows(vel_ned_m_s, stations=2, columns=3), VEL_NED_M_S)
    assert np.array_equal(unpack_rows(q_ned_frd, stations=2, columns=4), Q_NED_FRD)


def test_an_air_that_stays_quiet_is_never_left_so_far_behind_that_it_refuses_who_speaks_next(air, emulator):
    """A batch of any step, and a transmission of a second later, lie within `LEAD_US` of what it has reached.

    The steps are 100 ms here. Of three minutes' 1800 it is asked for the first, and then for one in each rest
    of `LONGEST_REST_US`: 180 s / 30 s of them, of which the last ends after the three minutes.
    """
    step_us, end_us = 100_000, 180_000_000
    for time_us in range(0, end_us, step_us):
        reached_us = emulator.asked[-1].to_us if emulator.asked else 0
        assert time_us + 1_000_000 <= reached_us + LEAD_US
        emulator.answers = [advanced(time_us + step_us, quiet_until_us=10**12)]
        air.begin(time_us, step_us, TRUTH, ())
        air.end()
    assert len(emulator.asked) == end_us // LONGEST_REST_US


def test_with_guests_no_step_is_left_out_for_they_may_speak_at_any_time(emulator):
    air = Air(emulator, "test", guests=True)
    for time_us in (0, 4_000, 8_000):
        step(air, emulator, time_us, quiet_until_us=10**9)
    assert [request.to_us for request in emulator.asked] == [4_000, 8_000, 12_000]


def test_attenuation_acts_on_the_steps_that_begin_after_it(air, emulator):
    for time_us, attenuation_db in ((0, None), (4_000, 30.0), (8_000, 30.0), (12_000, None)):
        air.extra_attenuation_db = attenuation_db
        step(air, emulator, time_us)
    told = {request.at_us: request.extra_attenuation_db for request in emulator.asked}
    assert told == {0: None, 4_000: 30.0, 8_000: 30.0, 12_000: None}


def test_who_has_not_taken_a_delivery_is_asked_about_until_it_has_or_is_gone(air, emulator):
    assert step(air, emulator, 0, unresponsive=(0, 1)) == (0, 1)
    emulator.answers = [advanced(4_000, unresponsive=(1,)), advanced(4_000)]
    assert air.wait_on(()) == (1,)
    assert air.wait_on((1,)) == ()
    assert [(request.to_us, request.silent) for request in emulator.asked] == [
        (4_000, ()), (4_000, ()), (4_000, (1,)),
    ]  # fmt: skip


def test_an_emulator_that_does_not_answer_is_an_error(air, emulator):
    emulator.answers = [None]
    air.begin(0, STEP_US, TRUTH, ())
    with pytest.raises(RadioSilent, match=r"the 802\.11 emulator does not answer"):
        air.end()

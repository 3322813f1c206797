"""When the emulator is asked to go on, what it is told, and what its answers mean."""

from types import SimpleNamespace

import numpy as np
import pytest

from harness.simulator.emulator_client import LONGEST_REST_US, EmulatorClient, RadioSilent
from netsim.wire.lockstep import LEAD_US, Advanced, unpack_rows

STEP_US = 4_000
PERIOD_US = 5 * STEP_US
POS_NED_M = np.arange(6.0).reshape(2, 3)
VEL_NED_M_S = -0.5 * POS_NED_M
Q_NED_FRD = np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0]])
TRUTH = SimpleNamespace(pos_ned_m=POS_NED_M, vel_ned_m_s=VEL_NED_M_S, q_ned_frd=Q_NED_FRD)


class Emulator:
    """Takes the place of the line to it; answers with what the test puts in."""

    def __init__(self):
        self.asked = []
        self.answers = []

    def send(self, message):
        self.asked.append(message)

    def receive(self):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture
def emulator():
    return Emulator()


@pytest.fixture
def air(emulator):
    return EmulatorClient(emulator, period_us=PERIOD_US)


def advanced(to_us, *, quiet_until_us=0, **changes):
    return Advanced(to_us=to_us, quiet_until_us=quiet_until_us, **changes)


def interval(air, emulator, time_us, senders=(), **answer):
    """The interval that begins at ``time_us``, if it is not skipped."""
    emulator.answers = [advanced(time_us + PERIOD_US, **answer)]
    air.begin(time_us, STEP_US, TRUTH, senders=senders)
    return air.end()


def test_a_quiet_air_is_left_alone_until_its_time_or_until_somebody_speaks(air, emulator):
    interval(air, emulator, 0, quiet_until_us=65_000)
    for time_us in (20_000, 40_000):
        interval(air, emulator, time_us)
    assert [request.to_us for request in emulator.asked] == [20_000]
    interval(air, emulator, 60_000, quiet_until_us=10**9)
    interval(air, emulator, 80_000, senders=(1,), quiet_until_us=10**9)
    interval(air, emulator, 100_000)
    assert [request.to_us for request in emulator.asked] == [20_000, 80_000, 100_000]
    assert [request.at_us for request in emulator.asked] == [0, 60_000, 80_000]
    assert [request.senders for request in emulator.asked] == [(), (), (1,)]
    assert [request.release_us for request in emulator.asked] == [20_000, 80_000, 100_000]
    (pos_ned_m,) = {request.pos_ned_m for request in emulator.asked}
    (vel_ned_m_s,) = {request.vel_ned_m_s for request in emulator.asked}
    assert np.array_equal(unpack_rows(pos_ned_m, stations=2, columns=3), POS_NED_M)
    (q_ned_frd,) = {request.q_ned_frd for request in emulator.asked}
    assert np.array_equal(unpack_rows(vel_ned_m_s, stations=2, columns=3), VEL_NED_M_S)
    assert np.array_equal(unpack_rows(q_ned_frd, stations=2, columns=4), Q_NED_FRD)


def test_an_air_that_stays_quiet_is_never_left_so_far_behind_that_it_refuses_who_speaks_next(emulator):
    """A batch of any step, and a transmission of a second later, lie within `LEAD_US` of what it has reached.

    The intervals are 100 ms here. Of three minutes' 1800 it is asked for the first, and then for one in each
    rest of `LONGEST_REST_US`: 180 s / 30 s of them, of which the last ends after the three minutes.
    """
    period_us, end_us = 100_000, 180_000_000
    air = EmulatorClient(emulator, period_us=period_us)
    for time_us in range(0, end_us, period_us):
        reached_us = emulator.asked[-1].to_us if emulator.asked else 0
        assert time_us + 1_000_000 <= reached_us + LEAD_US
        emulator.answers = [advanced(time_us + period_us, quiet_until_us=10**12)]
        air.begin(time_us, STEP_US, TRUTH)
        air.end()
    assert len(emulator.asked) == end_us // LONGEST_REST_US


def test_intervals_begin_at_the_multiples_of_their_period(air):
    assert [time_us for time_us in range(4_000, 64_000, STEP_US) if air.begins_at(time_us)] == [
        20_000, 40_000, 60_000,
    ]  # fmt: skip


def test_the_emulator_is_waited_for_when_its_interval_ends_and_not_before(air, emulator):
    assert not air.is_awaited(20_000)
    emulator.answers = [advanced(40_000)]
    air.begin(20_000, STEP_US, TRUTH)
    awaited_us = [time_us for time_us in range(24_000, 48_000, STEP_US) if air.is_awaited(time_us)]
    assert awaited_us == [40_000, 44_000]
    air.end()
    assert not air.is_awaited(40_000)


def test_with_free_radios_intervals_are_steps_and_none_is_left_out_for_who_may_speak_at_any_time(emulator):
    air = EmulatorClient(emulator, period_us=PERIOD_US, free=True)
    for time_us in (0, 4_000, 8_000):
        assert air.begins_at(time_us)
        assert not air.is_awaited(time_us)
        interval(air, emulator, time_us, quiet_until_us=10**9)
    assert [request.to_us for request in emulator.asked] == [4_000, 8_000, 12_000]
    assert [request.release_us for request in emulator.asked] == [8_000, 12_000, 16_000]


def test_attenuation_acts_on_the_intervals_that_begin_after_it(air, emulator):
    for time_us, attenuation_db in ((0, None), (20_000, 30.0), (40_000, 30.0), (60_000, None)):
        air.extra_attenuation_db = attenuation_db
        interval(air, emulator, time_us)
    told = {request.at_us: request.extra_attenuation_db for request in emulator.asked}
    assert told == {0: None, 20_000: 30.0, 40_000: 30.0, 60_000: None}


def test_whose_batch_is_missing_is_asked_about_until_it_has_come_or_is_gone(air, emulator):
    assert interval(air, emulator, 0, senders=(0, 1), missing=(0, 1)) == (0, 1)
    emulator.answers = [advanced(0, missing=(1,)), advanced(20_000, delivered=(0,))]
    assert air.wait_on(()) == (1,)
    assert air.wait_on((1,)) == ()
    assert [(request.to_us, request.senders, request.silent) for request in emulator.asked] == [
        (20_000, (0, 1), ()), (20_000, (0, 1), ()), (20_000, (0, 1), (1,)),
    ]  # fmt: skip
    assert air.delivered(20_000) == (0,)


def test_a_delivery_is_told_at_its_release_and_once_however_early_the_emulator_is_through(air, emulator):
    interval(air, emulator, 0, delivered=(0, 1))  # as before a pause
    assert [air.delivered(time_us) for time_us in (8_000, 16_000, 20_000)] == [(), (), (0, 1)]
    interval(air, emulator, 20_000, delivered=(1,))
    assert [air.delivered(time_us) for time_us in (20_000, 40_000, 60_000)] == [(), (1,), ()]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [(TimeoutError(), "the 802.11 emulator does not answer"), (None, "the 802.11 emulator is gone")],
)
def test_an_emulator_that_does_not_answer_or_is_gone_is_an_error(air, emulator, answer, reason):
    emulator.answers = [answer]
    air.begin(0, STEP_US, TRUTH)
    with pytest.raises(RadioSilent, match=reason):
        air.end()

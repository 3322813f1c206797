"""When the emulator is asked to go on, what it is told, and what its answers mean."""

import numpy as np
import pytest

from harness.air import Air, RadioSilent
from netsim.wire.messages import Advance, Advanced, decode, encode

STEP_US = 4_000
POS_NED_M = np.zeros((2, 3))


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
    emulator.answers.append(advanced(time_us, **answer))
    air.begin(time_us, STEP_US, POS_NED_M, ())
    return air.end()


def test_a_quiet_air_is_left_alone_until_its_time_or_until_somebody_speaks(air, emulator):
    step(air, emulator, 4_000, quiet_until_us=13_000)
    for time_us in (8_000, 12_000):
        step(air, emulator, time_us)
    assert [request.to_us for request in emulator.asked] == [4_000]
    emulator.answers.clear()
    step(air, emulator, 16_000, quiet_until_us=10**9)
    air.handed_over()
    step(air, emulator, 20_000, quiet_until_us=10**9)
    emulator.answers.clear()
    step(air, emulator, 24_000)
    assert [request.to_us for request in emulator.asked] == [4_000, 16_000, 20_000]
    assert [request.release_us for request in emulator.asked] == [8_000, 20_000, 24_000]


@pytest.mark.parametrize("quiet", [False, True])
def test_attenuation_acts_from_now_on_and_not_on_the_interval_that_is_still_to_be_simulated(
    air, emulator, quiet
):
    quiet_until_us = 10_000 if quiet else 0
    step(air, emulator, 4_000, quiet_until_us=quiet_until_us)
    air.set_extra_attenuation_db(30.0)  # at 8000 us, of which the air up to there has still to be simulated
    for time_us in (8_000, 12_000, 16_000):
        step(air, emulator, time_us, quiet_until_us=quiet_until_us)
    air.set_extra_attenuation_db(None)
    for time_us in (20_000, 24_000):
        step(air, emulator, time_us)
    told = {request.to_us: request.extra_attenuation_db for request in emulator.asked}
    expected = {4_000: None, 8_000: None, 12_000: 30.0, 16_000: 30.0, 20_000: 30.0, 24_000: None}
    if quiet:
        del expected[8_000]
    assert told == expected


def test_who_has_not_taken_a_delivery_is_asked_about_until_it_has_or_is_gone(air, emulator):
    assert step(air, emulator, 4_000, unresponsive=(0, 1)) == (0, 1)
    emulator.answers = [advanced(4_000, unresponsive=(1,)), advanced(4_000)]
    assert air.wait_on(()) == (1,)
    assert air.wait_on((1,)) == ()
    assert [(request.to_us, request.silent) for request in emulator.asked] == [
        (4_000, ()), (4_000, ()), (4_000, (1,)),
    ]  # fmt: skip


def test_an_emulator_that_does_not_answer_is_an_error(air, emulator):
    emulator.answers = [None]
    air.begin(4_000, STEP_US, POS_NED_M, ())
    with pytest.raises(RadioSilent, match=r"the 802\.11 emulator does not answer"):
        air.end()

"""Requests of the emulator client to the emulator: their times and contents, and its answers."""

from types import SimpleNamespace

import numpy as np
import pytest

from harness.simulator.emulator_client import MAX_QUIET_US, EmulatorClient, Pace, RadioSilent
from netsim.wire.lockstep import LEAD_US, Advanced, unpack_rows

STEP_US = 4_000
PERIOD_US = 5 * STEP_US
POS_NED_M = np.arange(6.0).reshape(2, 3)
VEL_NED_M_S = -0.5 * POS_NED_M
Q_NED_FRD = np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.8, 0.0]])
TRUTH = SimpleNamespace(pos_ned_m=POS_NED_M, vel_ned_m_s=VEL_NED_M_S, q_ned_frd=Q_NED_FRD)
RADIO = {"extra_attenuation_db": 0.0, "range_offsets_m": {}}


class Emulator:
    """Replaces the connection to the emulator; gives the answers that the test prepares."""

    def __init__(self):
        self.requests = []
        self.answers = []

    def send(self, message):
        self.requests.append(message)

    def receive(self):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture
def emulator():
    return Emulator()


@pytest.fixture
def client(emulator):
    return EmulatorClient(emulator, period_us=PERIOD_US)


def advanced(to_us, *, quiet_until_us=0, **changes):
    return Advanced(to_us=to_us, quiet_until_us=quiet_until_us, **changes)


def interval(client, emulator, time_us, senders=(), radio=RADIO, **answer):
    """Simulate the interval that begins at ``time_us``, if it is not skipped."""
    emulator.answers = [advanced(time_us + PERIOD_US, **answer)]
    client.begin(time_us, STEP_US, TRUTH, senders=senders, **radio)
    return client.end()


def test_a_quiet_interval_is_skipped_until_its_end_or_until_a_batch_is_handed_over(client, emulator):
    interval(client, emulator, 0, quiet_until_us=65_000)
    for time_us in (20_000, 40_000):
        interval(client, emulator, time_us)
    assert [request.to_us for request in emulator.requests] == [20_000]
    interval(client, emulator, 60_000, quiet_until_us=10**9)
    interval(client, emulator, 80_000, senders=(1,), quiet_until_us=10**9)
    interval(client, emulator, 100_000)
    assert [request.to_us for request in emulator.requests] == [20_000, 80_000, 100_000]
    assert [request.at_us for request in emulator.requests] == [0, 60_000, 80_000]
    assert [request.senders for request in emulator.requests] == [(), (), (1,)]
    assert [request.release_us for request in emulator.requests] == [20_000, 80_000, 100_000]
    (pos_ned_m,) = {request.pos_ned_m for request in emulator.requests}
    (vel_ned_m_s,) = {request.vel_ned_m_s for request in emulator.requests}
    assert np.array_equal(unpack_rows(pos_ned_m, stations=2, columns=3), POS_NED_M)
    (q_ned_frd,) = {request.q_ned_frd for request in emulator.requests}
    assert np.array_equal(unpack_rows(vel_ned_m_s, stations=2, columns=3), VEL_NED_M_S)
    assert np.array_equal(unpack_rows(q_ned_frd, stations=2, columns=4), Q_NED_FRD)


def test_a_quiet_emulator_never_falls_so_far_behind_that_it_refuses_the_next_batch(emulator):
    """A batch of any step, and a transmission one second later, lie within `LEAD_US` of the emulator's time.

    The intervals are 100 ms here. Of the 1800 in three minutes the first is requested, and then one in each
    `MAX_QUIET_US`: 180 s / 30 s of them, of which the last ends after the three minutes.
    """
    period_us, end_us = 100_000, 180_000_000
    client = EmulatorClient(emulator, period_us=period_us)
    for time_us in range(0, end_us, period_us):
        reached_us = emulator.requests[-1].to_us if emulator.requests else 0
        assert time_us + 1_000_000 <= reached_us + LEAD_US
        emulator.answers = [advanced(time_us + period_us, quiet_until_us=10**12)]
        client.begin(time_us, STEP_US, TRUTH, **RADIO)
        client.end()
    assert len(emulator.requests) == end_us // MAX_QUIET_US


def test_intervals_begin_at_the_multiples_of_their_period(client):
    assert [time_us for time_us in range(4_000, 64_000, STEP_US) if client.begins_at(time_us)] == [
        20_000, 40_000, 60_000,
    ]  # fmt: skip


def test_the_emulator_is_awaited_when_its_interval_ends_and_not_before(client, emulator):
    assert not client.is_pending(20_000)
    emulator.answers = [advanced(40_000)]
    client.begin(20_000, STEP_US, TRUTH, **RADIO)
    awaited_us = [time_us for time_us in range(24_000, 48_000, STEP_US) if client.is_pending(time_us)]
    assert awaited_us == [40_000, 44_000]
    client.end()
    assert not client.is_pending(40_000)


def test_with_asynchronous_radios_intervals_are_steps_and_none_is_skipped(emulator):
    client = EmulatorClient(emulator, period_us=PERIOD_US, asynchronous=True)
    for time_us in (0, 4_000, 8_000):
        assert client.begins_at(time_us)
        assert not client.is_pending(time_us)
        interval(client, emulator, time_us, quiet_until_us=10**9)
    assert [request.to_us for request in emulator.requests] == [4_000, 8_000, 12_000]
    assert [request.release_us for request in emulator.requests] == [8_000, 12_000, 16_000]


def test_steps_ahead_of_the_channel_release_its_deliveries_that_much_later(emulator):
    client = EmulatorClient(emulator, period_us=PERIOD_US, asynchronous=True, lead_steps=3)
    for time_us in range(0, 16_000, STEP_US):
        assert not client.is_pending(time_us)
        client.begin(time_us, STEP_US, TRUTH, **RADIO)
    assert [request.release_us for request in emulator.requests] == [16_000, 20_000, 24_000, 28_000]
    assert client.occupancy(16_000) == (0, 0)
    assert client.is_pending(16_000)
    emulator.answers = [advanced(4_000, delivered=(1,), busy_ns=700)]
    client.end()
    assert client.delivered(16_000) == (1,)
    assert not client.is_pending(16_000)
    assert (client.occupancy(16_000), client.busy_ns) == ((4_000, 700), 700)
    emulator.answers = [advanced(to_us, busy_ns=to_us // 10) for to_us in (8_000, 12_000, 16_000)]
    while client.is_busy:  # as before a pause
        client.end()
    assert [client.occupancy(time_us) for time_us in (16_000, 20_000, 24_000)] == [
        (4_000, 700), (8_000, 800), (12_000, 1_200),
    ]  # fmt: skip


def test_a_missing_batch_repeats_the_first_of_several_requests(emulator):
    client = EmulatorClient(emulator, period_us=PERIOD_US, asynchronous=True, lead_steps=3)
    client.begin(0, STEP_US, TRUTH, senders=(0,), **RADIO)
    client.begin(4_000, STEP_US, TRUTH, **RADIO)
    emulator.answers = [advanced(0, missing=(0,)), advanced(4_000), advanced(8_000)]
    assert client.end() == (0,)
    assert client.wait_on((0,)) == ()
    assert client.end() == ()
    assert not client.is_busy
    assert [(request.to_us, request.silent) for request in emulator.requests] == [
        (4_000, ()), (8_000, ()), (4_000, (0,)),
    ]  # fmt: skip


def test_attenuation_acts_on_the_intervals_that_begin_after_it(client, emulator):
    for time_us, attenuation_db in ((0, 0.0), (20_000, 30.0), (40_000, 30.0), (60_000, 0.0)):
        interval(client, emulator, time_us, radio=RADIO | {"extra_attenuation_db": attenuation_db})
    requested = {request.at_us: request.extra_attenuation_db for request in emulator.requests}
    assert requested == {0: 0.0, 20_000: 30.0, 40_000: 30.0, 60_000: 0.0}


def test_a_missing_batch_is_awaited_until_it_arrives_or_its_vehicle_is_lost(client, emulator):
    assert interval(client, emulator, 0, senders=(0, 1), missing=(0, 1)) == (0, 1)
    emulator.answers = [advanced(0, missing=(1,)), advanced(20_000, delivered=(0,))]
    assert client.wait_on(()) == (1,)
    assert client.wait_on((1,)) == ()
    assert [(request.to_us, request.senders, request.silent) for request in emulator.requests] == [
        (20_000, (0, 1), ()), (20_000, (0, 1), ()), (20_000, (0, 1), (1,)),
    ]  # fmt: skip
    assert client.delivered(20_000) == (0,)


def test_a_delivery_is_reported_once_at_its_release_however_early_the_emulator_is_done(client, emulator):
    interval(client, emulator, 0, delivered=(0, 1))  # as before a pause
    assert [client.delivered(time_us) for time_us in (8_000, 16_000, 20_000)] == [(), (), (0, 1)]
    interval(client, emulator, 20_000, delivered=(1,))
    assert [client.delivered(time_us) for time_us in (20_000, 40_000, 60_000)] == [(), (1,), ()]


@pytest.mark.parametrize(
    ("answer", "reason"),
    [(TimeoutError(), "the 802.11 emulator does not answer"), (None, "the 802.11 emulator is gone")],
)
def test_an_emulator_that_does_not_answer_or_is_gone_is_an_error(client, emulator, answer, reason):
    emulator.answers = [answer]
    client.begin(0, STEP_US, TRUTH, **RADIO)
    with pytest.raises(RadioSilent, match=reason):
        client.end()


def test_request_has_the_pace_at_its_end(emulator):
    paces = {STEP_US: Pace(7_000, 0.5)}
    client = EmulatorClient(emulator, period_us=PERIOD_US, asynchronous=True, pace=paces.__getitem__)
    client.begin(0, STEP_US, TRUTH, **RADIO)
    assert (emulator.requests[0].due_ns, emulator.requests[0].speed) == (7_000, 0.5)

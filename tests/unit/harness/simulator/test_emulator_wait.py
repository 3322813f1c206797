"""How long the emulator is waited for: as long as its process could answer."""

import psutil
import pytest

from harness.simulator import emulator_wait
from harness.simulator.emulator_client import RadioSilent
from harness.simulator.emulator_wait import POLL_S, RADIO_LIMIT_S, AwaitedLine, radio_watchdog
from harness.simulator.process_activity import ProcessState
from netsim.wire.lockstep import Advanced

DONE = Advanced(to_us=40_000, quiet_until_us=40_000)


class Line:
    """Times out some times and then answers; each time-out takes `POLL_S` of a clock that it owns."""

    def __init__(self, timeouts):
        self.timeouts = timeouts
        self.wall_s = 100.0
        self.sent = []

    def monotonic(self):
        return self.wall_s

    def send(self, message):
        self.sent.append(message)

    def receive(self):
        if not self.timeouts:
            return DONE
        self.timeouts -= 1
        self.wall_s += POLL_S
        raise TimeoutError


@pytest.fixture
def awaited(monkeypatch):
    def make(timeouts, *, call_limit_s=5.0):
        line, watchdog = Line(timeouts), radio_watchdog(call_limit_s, on_check=lambda _: None)
        monkeypatch.setattr(emulator_wait, "time", line)
        return AwaitedLine(line, watchdog)

    return make


def test_late_answers_are_received_and_requests_pass(awaited):
    line = awaited(20)
    line.send("request")
    assert line._line.sent == ["request"]
    assert line.receive() == DONE
    line._line.timeouts = 20  # of another wait
    assert line.receive() == DONE


@pytest.mark.parametrize(("call_limit_s", "limit_s"), [(5.0, RADIO_LIMIT_S), (60.0, 61.0)])
def test_a_sleeping_emulator_is_given_up_after_the_limit(awaited, monkeypatch, call_limit_s, limit_s):
    line = awaited(1_000, call_limit_s=call_limit_s)
    sleeps = ProcessState(psutil.STATUS_SLEEPING, 0.0)
    monkeypatch.setattr(line._watchdog, "_process_state", lambda _: sleeps)
    with pytest.raises(RadioSilent, match=r"^the 802\.11 emulator does not answer: it has not answered for"):
        line.receive()
    assert limit_s <= line._line.wall_s - 100.0 < limit_s + 2.0


def test_a_starved_emulator_is_waited_for(awaited, monkeypatch):
    line = awaited(1_000)
    starved = ProcessState(psutil.STATUS_RUNNING, 0.0)
    monkeypatch.setattr(line._watchdog, "_process_state", lambda _: starved)
    assert line.receive() == DONE

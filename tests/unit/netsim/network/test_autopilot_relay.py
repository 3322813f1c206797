"""The relay's limit of datagrams to an autopilot, with sockets in memory."""

import pytest

from netsim.network.autopilot_relay import DATAGRAMS_PER_PERIOD, DATAGRAMS_PER_TURN, PERIOD_S, AutopilotRelay
from netsim.network.companion_sockets import PROGRAM, CompanionSockets
from netsim.network.messages import CompanionLink

LINK = CompanionLink(
    station=0, companion_host="127.0.0.1", companion_port=14_540, autopilot_host="127.0.0.1", autopilot_port=0
)
"""Of an autopilot that has not been received from: what programs send is dropped."""


class Socket:
    """Datagrams of a program."""

    def __init__(self):
        self.waiting = 0

    def recvfrom(self, _):
        if not self.waiting:
            raise BlockingIOError
        self.waiting -= 1
        return b"x", (PROGRAM[0], 5_000)


class Selector:
    """As `selectors` it refuses to register twice."""

    def __init__(self):
        self.keys = {}

    def register(self, file, _, data):
        if file in self.keys:
            raise KeyError(file)
        self.keys[file] = data

    def unregister(self, file):
        del self.keys[file]

    def turns(self):
        """Read as long as a socket that is registered is ready."""
        while ready := [data for file, data in self.keys.items() if file.waiting]:
            for data in ready:
                data.read()


class NoReceivers(CompanionSockets):
    def receives(self, _):
        return False


@pytest.mark.parametrize("more", [0, 1, 1_000])
@pytest.mark.parametrize("first", range(DATAGRAMS_PER_TURN + 1))
def test_flood_is_read_up_to_the_limit_of_each_period(first, more):
    link, selector = Socket(), Selector()
    relay = AutopilotRelay([(LINK, NoReceivers(link, 0, None))], selector, lambda: 0.0)
    relay.update(0.0)
    for period in range(1, 4):
        for waiting in (first, DATAGRAMS_PER_PERIOD - first):  # the last is read at any place of a turn
            link.waiting = waiting
            selector.turns()
        link.waiting = more
        selector.turns()
        assert relay.counters["dropped"] == period * DATAGRAMS_PER_PERIOD
        assert link.waiting == more
        link.waiting = 0
        relay.update(period * PERIOD_S)
        assert link in selector.keys

"""The protocol on a bus that loses datagrams and acknowledgements: one token, and recovery in time."""

import numpy as np
import pytest
from token_ring.protocol import Ring, Timing, Token, decode

STEP_US = 40_000
DELAY_US = 50_000


class Bus:
    """Stations and their unicasts; ``loses`` returns whether the datagram, and its outcome, are lost."""

    def __init__(self, count, loses=lambda: (False, False)):
        self.timing = Timing(stations=count, hold_us=80_000, pass_us=160_000)
        self.rings = [Ring(i, self.timing) for i in range(count)]
        self.loses, self.now_us, self.most_holders = loses, 0, 0
        self.dead = set()
        self._events = []

    def run(self, duration_s):
        end_us = self.now_us + int(1e6 * duration_s)
        while self.now_us < end_us:
            self.now_us += STEP_US
            due = [event for event in self._events if event[0] <= self.now_us]
            self._events = [event for event in self._events if event[0] > self.now_us]
            for _, station, deliver in due:
                if station not in self.dead:
                    self._send(station, deliver(self.rings[station]))
            for ring in self.living():
                self._send(ring.station, ring.on_timer(self.now_us))
            self.most_holders = max(self.most_holders, self.holders())

    def living(self):
        return [ring for ring in self.rings if ring.station not in self.dead]

    def holders(self):
        return sum(ring.holds for ring in self.living())

    def rounds(self):
        return max(ring.rounds for ring in self.living())

    def _send(self, source, unicast):
        if unicast is None:
            return
        destination, token = unicast
        lost, unacknowledged = self.loses()
        at_us = self.now_us + DELAY_US
        received = not lost and destination not in self.dead
        if received:
            self._events.append((at_us, destination, lambda ring: ring.on_token(token, self.now_us)))
        confirmed = received and not unacknowledged

        def outcome(ring):
            return ring.on_outcome(destination, self.now_us, acknowledged=confirmed)

        self._events.append((at_us if confirmed else at_us + STEP_US, source, outcome))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_without_loss_one_station_makes_a_token_which_never_has_two_holders(count):
    bus = Bus(count)
    bus.run(60.0)
    assert bus.most_holders == 1
    assert [ring.regenerated for ring in bus.rings] == [1] + [0] * (count - 1)
    # a turn: two steps of hold, and a delivery in the second step after it
    turns = (60e6 - bus.timing.timeout_us(0)) / (4 * STEP_US)
    assert bus.rounds() == pytest.approx(turns / count, abs=1)
    assert max(ring.turns for ring in bus.rings) - min(ring.turns for ring in bus.rings) <= 1


@pytest.mark.parametrize("seed", range(10))
def test_after_losses_there_is_one_token_again_within_a_time_out_and_a_round(seed):
    rng = np.random.default_rng(seed)
    lossy = [True]
    bus = Bus(5, lambda: (lossy[0] and rng.random() < 0.3, lossy[0] and rng.random() < 0.3))
    bus.run(30.0)
    lossy[0] = False
    bus.run(1e-6 * (bus.timing.timeout_us(4) + bus.timing.timeout_us(0)))
    bus.most_holders, before = 0, bus.rounds()
    bus.run(10.0)
    assert bus.most_holders == 1
    assert bus.rounds() > before + 3


def test_the_token_of_a_holder_that_ends_is_made_again_in_time():
    bus = Bus(4)
    bus.run(10.0)
    while not bus.rings[2].holds:
        bus.run(1e-6 * STEP_US)
    bus.dead.add(2)
    made = sum(ring.regenerated for ring in bus.living())
    bus.run(1e-6 * (bus.timing.timeout_us(3) + STEP_US))
    assert sum(ring.regenerated for ring in bus.living()) == made + 1
    before = bus.rounds()
    bus.run(5.0)
    assert bus.rounds() > before + 4
    assert bus.holders() <= 1


def test_a_station_alone_keeps_the_token_and_one_that_returns_is_included():
    bus = Bus(2)
    bus.run(5.0)
    bus.dead.add(1)
    bus.run(10.0)
    assert bus.rings[0].turns > 50
    bus.dead.clear()
    turns = bus.rings[1].turns
    bus.run(10.0)
    assert bus.rings[1].turns > turns + 10
    bus.most_holders = 0
    bus.run(5.0)
    assert bus.most_holders == 1


def test_a_token_is_decoded_as_it_was_encoded_and_other_bytes_are_none():
    token = Token(3, 2**40)
    payload = token.encode()
    assert decode(payload) == token
    assert [decode(each) for each in (b"", payload[:-1], payload + b"x", b"X" + payload[1:])] == [None] * 4
    assert decode(Token(2**32 - 1, 0).encode()) is decode(Token(0, 2**64 - 1).encode()) is None

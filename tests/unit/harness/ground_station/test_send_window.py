"""What a ground station gives its radio: few frames without an outcome, the newest of what waits."""

import pytest

from harness.ground_station.send_window import MOST_UNREPORTED, MOST_WAITING, OUTCOME_LIMIT_US, SendWindow

LIFETIME_US = 500_000


class Radio:
    """A radio behind a window, whose outcomes a test reports."""

    def __init__(self, vehicles=1, queue_frames=64):
        self.window = SendWindow(vehicles, queue_frames=queue_frames, queue_lifetime_us=LIFETIME_US)
        self.frames = []
        """Vehicle, sequence number and content of all frames so far."""
        self.reported = 0

    def take(self):
        """Take what the window gives; return the contents."""
        first = len(self.frames)
        while (due := self.window.take()) is not None:
            vehicle, datagram = due
            self.window.on_sent(vehicle, len(self.frames))
            self.frames.append((vehicle, len(self.frames), datagram))
        return [datagram for _, _, datagram in self.frames[first:]]

    def report(self, count):
        """Report the next outcomes."""
        for vehicle, seq, _ in self.frames[self.reported : self.reported + count]:
            self.window.on_reported(vehicle, seq)
        self.reported += count


def contents(numbers):
    return [b"%d" % number for number in numbers]


@pytest.fixture
def paused():
    """Return a radio to which 200 datagrams were sent while simulated time rested."""
    radio = Radio()
    for datagram in contents(range(200)):
        radio.window.put(0, datagram)
        radio.take()
    return radio


def test_after_a_pause_the_newest_datagrams_follow_in_order(paused):
    kept = contents(range(200 - MOST_WAITING, 200))
    assert [each[2] for each in paused.frames] == contents(range(MOST_UNREPORTED))
    assert paused.window.overtaken == 200 - MOST_UNREPORTED - MOST_WAITING
    paused.report(3)
    assert paused.take() == kept[:3]
    while paused.reported < len(paused.frames):
        paused.report(1)
        paused.take()
    assert [each[2] for each in paused.frames] == contents(range(MOST_UNREPORTED)) + kept


@pytest.mark.parametrize(("vehicles", "queue_frames"), [(1, 64), (3, 64), (8, 64), (100, 64), (2, 1), (1, 5)])
def test_the_queue_of_the_radio_never_overflows(vehicles, queue_frames):
    radio = Radio(vehicles, queue_frames)
    for number in range(50 * vehicles):
        radio.window.put(number % vehicles, b"")
        radio.take()
    assert len(radio.frames) == min(queue_frames, vehicles * MOST_UNREPORTED)
    for _ in range(20 * vehicles):
        radio.report(1)
        assert len(radio.take()) == 1
    # of vehicles with the same traffic each gets the same share
    shares = [sum(to == vehicle for to, _, _ in radio.frames) for vehicle in range(vehicles)]
    assert max(shares) - min(shares) <= 1 + MOST_UNREPORTED * (vehicles * MOST_UNREPORTED > queue_frames)


def test_a_vehicle_without_outcomes_does_not_hold_up_another():
    radio = Radio(2)
    for number in range(100):
        radio.window.put(0, b"far")
        radio.take()
        radio.window.put(1, b"%d" % number)
        radio.take()
        vehicle, seq, datagram = radio.frames[-1]
        assert (vehicle, datagram) == (1, b"%d" % number)
        radio.window.on_reported(vehicle, seq)


def test_lost_outcomes_hold_the_window_for_a_limited_simulated_time(paused):
    limit_us = LIFETIME_US + OUTCOME_LIMIT_US
    # the first delivery after a frame begins its time, however late it is
    paused.window.advance(60_000_000)
    paused.window.advance(60_000_000 + limit_us)
    assert paused.take() == []
    paused.window.advance(60_000_001 + limit_us)
    assert len(paused.take()) == MOST_UNREPORTED
    # an outcome that arrives all the same makes no room for a second time
    paused.report(MOST_UNREPORTED)
    assert paused.take() == []
    paused.report(MOST_UNREPORTED)
    assert len(paused.take()) == MOST_UNREPORTED

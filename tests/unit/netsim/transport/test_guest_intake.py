"""A guest's transmissions are limited in each interval, and what is dropped is counted."""

import logging

from netsim.transport.guest_intake import GuestIntake
from netsim.transport.malformed import MalformedCount
from netsim.wire.messages import MOST_GUEST_ITEMS

GROUND, CAR = 8, 9


def make_intake():
    return GuestIntake({GROUND: "guest ground", CAR: "guest car"})


def test_batches_are_accepted_up_to_the_limit_of_each_guest():
    intake = make_intake()
    assert intake.accept(GROUND, MOST_GUEST_ITEMS - 1)
    assert not intake.accept(GROUND, 2)  # a batch is accepted as a whole, or not
    assert not intake.is_full(GROUND)
    assert intake.accept(GROUND, 1)
    assert intake.is_full(GROUND)
    assert intake.accept(CAR, MOST_GUEST_ITEMS)
    assert intake.dropped == {"guest ground": 1}


def test_an_interval_allows_as_many_again():
    intake = make_intake()
    for _ in range(3):
        assert intake.accept(GROUND, MOST_GUEST_ITEMS)
        assert not intake.accept(GROUND, 1)
        intake.begin_interval()
    assert intake.dropped == {"guest ground": 3}


def test_a_flood_is_one_line_in_the_log(caplog):
    intake = make_intake()
    with caplog.at_level(logging.WARNING):
        for _ in range(100_000):
            intake.accept(GROUND, 1)
    (record,) = caplog.records
    assert record.getMessage().startswith(f"guest ground has sent more than {MOST_GUEST_ITEMS} transmissions")
    assert intake.dropped == {"guest ground": 100_000 - MOST_GUEST_ITEMS}


def test_malformed_messages_are_logged_ever_more_rarely(caplog):
    malformed = MalformedCount("message of guest ground")
    with caplog.at_level(logging.WARNING):
        for _ in range(12_345):
            malformed.add(7)
    assert malformed.count == 12_345
    assert [record.getMessage() for record in caplog.records] == [
        f"dropped 7 bytes that are not a valid message of guest ground; {count} so far"
        for count in (1, 10, 100, 1_000, 10_000)
    ]

"""Events in words: each kind that a run can record, and one of a later version."""

import pytest

from harness.records.event_words import Level, in_words
from harness.simulator.truth_record import EVENT_KINDS

EVENTS = {
    "formed": ({}, (Level.INFO, None, "formation reached")),
    "formationmoves": ({"start_us": 12_500_000}, (Level.INFO, None, "formation moves from 12.500 s on")),
    "applicationtext": ({"instance": 1, "text": "at work"}, (Level.INFO, 1, "application: at work")),
    "vehiclelost": ({"instance": 2, "reason": "it ended"}, (Level.ERROR, 2, "lost: it ended")),
    "applicationlost": ({"instance": 0, "reason": "r"}, (Level.ERROR, 0, "application lost: r")),
    "collision": ({"first": 3, "second": 1}, (Level.ERROR, 3, "touches UAV 1")),
    "faultchanged": (
        {"instance": 3, "number": 0, "what": "motor", "motor": 2, "change": "began"},
        (Level.WARNING, 3, "fault 0 (motor 2) began"),
    ),
    "news": ({"instance": 4, "what": "x"}, (Level.INFO, 4, "news what = x")),
}


@pytest.mark.parametrize("kind", EVENTS)
def test_an_event_has_words(kind):
    fields, words = EVENTS[kind]
    assert in_words({"event": kind, "time_us": 5, **fields}) == words


def test_no_kind_of_event_is_left_out():
    assert {*EVENTS} >= {*EVENT_KINDS}

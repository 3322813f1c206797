"""Durations are shown in words."""

from foundation.durations import duration_text


def test_durations_are_in_words():
    texts = [duration_text(seconds) for seconds in (None, 0.0, 59.4, 59.6, 250.0, 3599.7, 11_100.0)]
    assert texts == ["?", "0 s", "59 s", "1 min 00 s", "4 min 10 s", "1 h 00 min", "3 h 05 min"]

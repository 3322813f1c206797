"""The order in which a feed sends pieces, and how many it holds."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rerun", reason="the extra coflight[view] is not installed")
from harness.view import feed
from harness.view.feed import MOST_WHOLE, send_newest_whole

PIECES = 50


class Counted:
    """A feed that notes what is sent, and the most pieces that were given and not yet sent."""

    def __init__(self):
        self.sent, self.thin, self.given, self.most_held = [], [], 0, 0

    def pieces(self):
        for number in range(PIECES):
            self.given += 1
            self.most_held = max(self.most_held, self.given - len(self.sent))
            yield number

    def send(self, piece, *, thin=False):
        self.sent.append(piece)
        self.thin.append(thin)


@pytest.mark.parametrize("whole", [False, True])
def test_a_backlog_is_sent_in_order_and_few_pieces_of_it_are_held(whole):
    counted = Counted()
    send_newest_whole(counted, counted.pieces(), whole=whole)
    assert counted.sent == list(range(PIECES))
    assert counted.thin == [not whole and number < PIECES - MOST_WHOLE for number in range(PIECES)]
    assert counted.most_held <= MOST_WHOLE + 1


def test_pieces_are_sent_whole_if_few_are_there():
    counted = Counted()
    send_newest_whole(counted, iter(range(MOST_WHOLE)), whole=False)
    assert counted.sent == list(range(MOST_WHOLE))
    assert not any(counted.thin)


@pytest.mark.parametrize(
    ("options", "whole"),
    [
        (["--url", "rerun"], False),
        (["--record", "a.rrd"], True),
        (["--url", "rerun", "--record", "a.rrd"], True),
    ],
)
def test_a_recording_has_all_instants_also_beside_a_viewer(monkeypatch, options, whole):
    asked = []
    monkeypatch.setattr(feed, "RerunSink", lambda *_, **__: SimpleNamespace(close=lambda: True))
    monkeypatch.setattr(feed, "follow", lambda *_, whole: asked.append(whole))
    assert feed.main(["run", *options]) == 0
    assert asked == [whole]


def test_a_file_that_cannot_be_written_is_named_in_one_line(tmp_path, capsys):
    file = tmp_path / "missing" / "a.rrd"
    assert feed.main(["run", "--record", str(file)]) == 1
    assert capsys.readouterr().err == f"{file}: No such file or directory\n"

"""The feed: reads a run's records and sends what they show to a viewer, a file or both.

`main` follows a flight, from a process of its own (`harness.view.feed_program`), until the end of its stdin:
nothing waits for it. `replay` sends a run that has ended. A feed that is behind its flight shows fewer
instants.
"""

import argparse
import contextlib
import os
import sys
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from antenna.solvers.interface import Backend, BackendUnavailable
from foundation.system_error import in_words
from harness.records.live_pieces import LivePieces
from harness.records.pieces import Piece, pieces_of_tables
from harness.records.run_folder import RunFolder, read_raw_scenario, read_scenario
from harness.scenario.scenario import Scenario
from harness.view.antenna_surface import live_solver, surface_at
from harness.view.camera import overview
from harness.view.entries import Entry
from harness.view.rerun_sink import RerunSink
from harness.view.scene import Scene, scalars, surface_entries

STEP_US = 500_000
"""Simulated time that is sent at once in flight"""
REPLAY_STEP_US = 1_000_000
"""The same of a run that has ended: a viewer is faster with few and large messages"""
SURFACE_US = 1_000_000
"""Simulated time between two patterns of the antenna"""
PERIOD_S = 0.05
"""Wall time between two looks at the logs"""
STDIN = 0
MOST_WHOLE = 10
"""Pieces that are sent with all instants if more are there at once"""


class Feed:
    """Sends the pieces of one run, in the order of time."""

    def __init__(self, folder: RunFolder, scenario: Scenario, sink: RerunSink) -> None:
        self._scenario, self._sink = scenario, sink
        self._scene = Scene(scenario, folder.applications())
        self._solver: Backend | None = None
        self._has_solver = True
        self._surface_us = 0
        sink.arrange(overview(scenario.places_ned_m()))
        sink.send(self._scene.static())

    def send(self, piece: Piece, *, thin: bool = False) -> None:
        """Send what a piece shows; with ``thin`` its last instant only, and no antenna."""
        self._sink.send(self._scene.entries(piece, thin=thin))
        if not thin:
            self._sink.send(self._antenna(piece))

    def _antenna(self, piece: Piece) -> list[Entry]:
        due = piece.until_us >= self._surface_us + SURFACE_US
        if not (due and self._has_solver and self._scene.formed and len(piece.flight)):
            return []
        self._surface_us = piece.until_us
        if self._solver is None:
            try:
                self._solver = live_solver(self._scenario.antenna)
            except BackendUnavailable:
                self._has_solver = False
                return []
        flight = self._scene.flight(piece.flight[-1:])
        surface = surface_at(flight, 0, self._scenario.antenna, self._solver)
        if surface is None:
            return []
        found = surface_entries(surface, int(flight.time_us[0]))
        if piece.gains is None:
            gain_dbi = np.array([surface.max_gain_dbi])
            found.append(scalars("plots/gain/maximum", flight.time_us, gain_dbi))
        return found


def send_newest_whole(feed: Feed, pieces: Iterable[Piece], *, whole: bool) -> None:
    """Send pieces, without ``whole`` all but the newest `MOST_WHOLE` thin; no more than these are held."""
    newest: deque[Piece] = deque()
    for piece in pieces:
        newest.append(piece)
        if whole or len(newest) > MOST_WHOLE:
            feed.send(newest.popleft(), thin=not whole)
    while newest:
        feed.send(newest.popleft())


def follow(folder: RunFolder, sink: RerunSink, ended: threading.Event, *, whole: bool) -> None:
    """Send a flight that goes on, until ``ended`` and the end of its logs; ``whole``: all its instants."""
    scenario = read_raw_scenario(folder)
    feed = Feed(folder, scenario, sink)
    with LivePieces(folder, scenario, step_us=STEP_US) as live:
        is_last = False
        while not is_last:
            is_last = ended.is_set()
            send_newest_whole(feed, live.advance(ended=is_last), whole=whole)
            if not is_last:
                ended.wait(PERIOD_S)


def replay(folder: RunFolder, sink: RerunSink) -> None:
    """Send a reported run. Raises OSError, NotARun and as `read_scenario`."""
    scenario = read_scenario(folder)
    feed = Feed(folder, scenario, sink)
    for piece in pieces_of_tables(folder, scenario, step_us=REPLAY_STEP_US):
        feed.send(piece)


def main(arguments: Sequence[str] | None = None) -> int:
    """Follow a flight; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m harness.view.feed_program")
    parser.add_argument("run", type=Path)
    parser.add_argument("--url")
    parser.add_argument("--record", type=Path)
    options = parser.parse_args(arguments)
    ended = threading.Event()

    def await_end() -> None:
        # not by sys.stdin, whose lock a thread that waits would hold when the process exits
        with contextlib.suppress(OSError):
            while os.read(STDIN, 4096):
                pass
        ended.set()

    threading.Thread(target=await_end, daemon=True).start()
    try:
        sink = RerunSink(options.run.name, url=options.url, file=options.record)
    except OSError as error:
        sys.stderr.write(f"{in_words(error)}\n")
        return 1
    follow(RunFolder(options.run), sink, ended, whole=options.record is not None)
    if not sink.close():
        sys.stderr.write("the viewer is gone\n")
    return 0

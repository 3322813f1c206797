"""Modes and failsafes of the vehicles as state time lines, in colours that are the same for all vehicles."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.records.columns import Column
from harness.records.pieces import Rows
from harness.view.entries import Colour, Entry, at_all_times, colour_of

NO_FAILSAFE = "none"
"""State without a failsafe; a vehicle that had none has no line of it, so that more modes are in sight"""
LOST = "lost"
GREY: Colour = (130, 130, 130)
RED: Colour = (215, 60, 60)
"""Colour of failsafes and of losses"""
COLOURS = tuple(
    colour_of(text)
    for text in ("#4c78a8", "#d08030", "#8a6fb0", "#3f9d96", "#54a24b", "#9d755d", "#b0903a", "#c06a96")
)
"""Colours of modes, in the order in which these are entered first"""


class StateLines:
    """The states of a run's vehicles, made in the order of time; ``columns`` are those of the flight."""

    def __init__(self, columns: Mapping[str, Column]) -> None:
        self._modes, self._phases = columns["mode"].values, columns["phase"].values
        self._causes = columns["causes"].values
        self._states: dict[str, str] = {}
        """Present state by path"""
        self._modes_entered: dict[str, Colour] = {}
        self._colours: dict[str, dict[str, Colour]] = {}
        """Colours of the states that a path had"""

    def entries(self, flight: Rows, times_us: NDArray[np.int64]) -> list[Entry]:
        """Return the changes of states in records (T, N), and the colours of new states."""
        found = []
        for i in range(flight.shape[1]):
            for t in range(len(times_us)):
                for path, text in self._states_of(i, flight[t, i]).items():
                    if self._states.get(path, NO_FAILSAFE) == text:
                        continue
                    self._states[path] = text
                    found += self._new_colour(path, text)
                    at = times_us[t : t + 1]
                    found.append(Entry(path=path, kind="StateChange", times_us=at, fields={"state": [text]}))
        return found

    def _new_colour(self, path: str, text: str) -> list[Entry]:
        """Return the colours of a path's states if one is new."""
        of_path = self._colours.setdefault(path, {})
        if text in of_path:
            return []
        of_path[text] = self._colour(path, text)
        colours = list(of_path.values())
        return [at_all_times(path, "StateConfiguration", values=list(of_path), colors=colours)]

    def _colour(self, path: str, text: str) -> Colour:
        if text == NO_FAILSAFE:
            return GREY
        if text == LOST or path.endswith("failsafe"):
            return RED
        following = COLOURS[len(self._modes_entered) % len(COLOURS)]
        return self._modes_entered.setdefault(text, following)

    def _states_of(self, vehicle: int, row: Any) -> dict[str, str]:  # noqa: ANN401  a record
        if not row["alive"]:
            return {f"states/uav-{vehicle}/mode": LOST, f"states/uav-{vehicle}/failsafe": LOST}
        mode = self._modes.get(str(row["mode"]), f"mode {row['mode']}")
        phase = self._phases.get(str(row["phase"]), "")
        causes = [text for bit, text in self._causes.items() if int(row["causes"]) & int(bit)]
        failsafe = (", ".join(causes) or "active") if row["failsafe"] else NO_FAILSAFE
        return {
            f"states/uav-{vehicle}/mode": f"{mode}, {phase}" if phase else mode,
            f"states/uav-{vehicle}/failsafe": failsafe,
        }

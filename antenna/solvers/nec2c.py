"""Backend ``nec2c``: the program nec2c, an independent check of PyNEC.

It reads a deck and prints radiation patterns. Gains are computed from the printed fields, which have four
more digits than the printed decibels.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from antenna.analysis.patterns import to_dbi
from antenna.model.array_deck import write_deck
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.nec2_common import FarField, Nec2Solver, NoPower

ETA_NEC_OHM = 376.73
TIMEOUT_S = 120.0


class Nec2cUnavailable(BackendUnavailable):
    """The program is not installed."""


class Nec2cFailed(RuntimeError):
    """The program returned no pattern; the text is one line."""


class Nec2cFarField(FarField):
    """One array, solved again at every request; raises Nec2cFailed."""

    def _grid(self, rows: int, columns: int, step_deg: float) -> Array:
        found = self._run(self._cards(step_deg))
        if len(found) != rows * columns:
            raise Nec2cFailed(f"nec2c returned {len(found)} directions; expected {rows} by {columns}")
        return found.reshape(columns, rows, 2).transpose(2, 1, 0)

    def _towards_dbi(self, directions_deg: Sequence[tuple[float, float]]) -> Array:
        requests = [f"RP 0 1 1 1000 {theta:.9g} {phi:.9g} 0 0 0 0" for theta, phi in directions_deg]
        *array, _, _ = self._cards(self._config.grid_deg)
        return to_dbi(self._run([*array, *requests, "EN"]).sum(axis=1))

    def _cards(self, step_deg: float) -> list[str]:
        """Return the deck of the array; its last two cards request the grid and end the deck."""
        return write_deck(self._snapshot, self._config, step_deg=step_deg).splitlines()

    def _run(self, cards: list[str]) -> Array:
        """Return linear gains (D, 2), theta and phi polarisation, of all directions that a deck requests."""
        with tempfile.TemporaryDirectory() as folder:
            deck, output = Path(folder) / "deck.nec", Path(folder) / "deck.out"
            deck.write_text("\n".join(cards) + "\n", encoding="ascii")
            ended = subprocess.run(
                [_program(), "-i", str(deck), "-o", str(output)],
                capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
            )  # fmt: skip
            text = output.read_text(encoding="latin-1") if output.exists() else ""
        return _read_gains(text, (ended.stderr or ended.stdout).strip().splitlines())


class Nec2c(Nec2Solver):
    """Patterns by nec2c."""

    name = "nec2c"
    far_field = Nec2cFarField

    def __init__(self, config: AntennaConfig) -> None:
        super().__init__(config)
        _program()  # raises here if unavailable


def _program() -> str:
    program = shutil.which("nec2c")
    if program is None:
        raise Nec2cUnavailable("nec2c patterns need the program nec2c, available as a Debian package")
    return program


def _read_gains(text: str, messages: list[str]) -> Array:
    """Return the gains from the fields at 1 m, G = 4 pi |E|^2 / (2 eta P)."""
    power_w, fields, inside = 0.0, [], False
    for line in text.splitlines():
        words = line.split()
        if "INPUT POWER" in line:
            power_w = float(words[words.index("=") + 1])
        elif "RADIATION PATTERNS" in line:
            inside = True
        elif inside and len(words) in (11, 12) and _is_number(words[0]):
            # SENSE is a word or, without a field, empty
            fields.append((float(words[-4]), float(words[-2])))
        elif inside and words and not _is_number(words[0]) and words[0] not in {"----", "THETA", "DEGREES"}:
            inside = False
    if fields and power_w <= 0.0:
        raise NoPower(f"nec2c returned no pattern: the input power is {power_w:g} W")
    if not fields:
        raise Nec2cFailed(f"nec2c returned no pattern: {messages[-1] if messages else 'no output'}")
    return np.asarray(np.array(fields) ** 2 * (4.0 * np.pi / (2.0 * ETA_NEC_OHM * power_w)))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

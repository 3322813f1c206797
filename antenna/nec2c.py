"""nec2c as backend: the program of that name, a second witness beside PyNEC.

A deck goes in, and the radiation patterns of the output come back. Gains are of the printed fields, which
have four digits more than the printed decibels have places.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from antenna.array_deck import ground_of
from antenna.backend import Accuracy, BackendUnavailable
from antenna.clearance import check_apart
from antenna.config import AntennaConfig
from antenna.deck import write_deck
from antenna.geometry import Array, ElementsTooNear, ElementsTouch, Snapshot
from antenna.patterns import Pattern, decimated, directions_deg, make_pattern, to_dbi
from antenna.witness import check_credible, check_height, grid_step_deg, solve_finer

ETA_NEC_OHM = 376.73
TIMEOUT_S = 120.0


class Nec2cUnavailable(BackendUnavailable):
    """The program is not installed."""


class Nec2cFailed(RuntimeError):
    """The program did not give a pattern; the text is one line."""


class NoPower(Nec2cFailed):
    """The sources feed nothing in, or less."""


class Nec2c:
    """Patterns of arrays of alike elements."""

    name = "nec2c"
    accuracy = Accuracy.REFERENCE

    def __init__(self, config: AntennaConfig) -> None:
        program = shutil.which("nec2c")
        if program is None:
            raise Nec2cUnavailable("nec2c patterns need the program nec2c, which Debian has as a package")
        self._program = program
        self._config = config
        self._element = config.element()
        self._ground = ground_of(config)

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """See `antenna.backend.Backend`."""
        results: list[Pattern | ElementsTouch] = []
        for snapshot in snapshots:
            try:
                results.append(self.pattern(snapshot))
            except ElementsTouch as touch:
                results.append(touch)
        return results

    def pattern(self, snapshot: Snapshot) -> Pattern:
        """Pattern of one snapshot; raises `ElementsTouch`, `ElementsTooNear`, Nec2cFailed."""
        config, grounded = self._config, self._ground is not None
        found = check_apart(snapshot, self._element, grounded=grounded)
        check_height(snapshot, self._element, config)
        times = solve_finer(snapshot, self._element, config)
        cards = self._cards(snapshot, config.grid_deg)

        def gain_at(theta: Array, phi: Array) -> Array:
            if self._ground is not None:
                theta = np.minimum(theta, 180.0 - theta)
            asked = [
                f"RP 0 1 1 1000 {a:.9g} {b:.9g} 0 0 0 0"
                for a, b in zip(theta.ravel().tolist(), phi.ravel().tolist(), strict=True)
            ]
            return to_dbi(self._run([*cards[:-2], *asked, "EN"]).sum(axis=1)).reshape(theta.shape)

        try:
            theta_gain, phi_gain = self._partial_gains(snapshot, grid_step_deg(config) / times)
            pattern = make_pattern(
                theta_gain, phi_gain, gain_at, snapshot, config.wavelength_m, self.name, grounded=grounded
            )
        except NoPower:
            raise ElementsTooNear(*found) from None
        check_credible(pattern, found, config)
        return decimated(pattern, times)

    def _cards(self, snapshot: Snapshot, step_deg: float) -> list[str]:
        """Deck of a snapshot, the last two cards of which ask for the grid and end it."""
        return write_deck(
            snapshot, self._element, self._config.wavelength_m, ground=self._ground, step_deg=step_deg
        ).splitlines()

    def _partial_gains(self, snapshot: Snapshot, step_deg: float) -> Array:
        """(2, T, P) linear gains in the theta and phi polarisations on the grid of `directions_deg`.

        Raises Nec2cFailed unless there are as many as were asked for.
        """
        theta_deg, phi_deg = directions_deg(step_deg)
        seen = len(theta_deg) if self._ground is None else len(theta_deg) // 2 + 1
        found = self._run(self._cards(snapshot, step_deg))
        if len(found) != seen * len(phi_deg):
            raise Nec2cFailed(f"nec2c gave {len(found)} directions; expected {seen} by {len(phi_deg)}")
        gains = np.zeros((2, len(theta_deg), len(phi_deg)))
        gains[:, :seen] = found.reshape(len(phi_deg), seen, 2).transpose(2, 1, 0)
        return gains

    def _run(self, cards: list[str]) -> Array:
        """(D, 2) linear gains, theta and phi polarisation, of all directions that a deck asks for."""
        with tempfile.TemporaryDirectory() as folder:
            deck, output = Path(folder) / "deck.nec", Path(folder) / "deck.out"
            deck.write_text("\n".join(cards) + "\n", encoding="ascii")
            ended = subprocess.run(
                [self._program, "-i", str(deck), "-o", str(output)],
                capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
            )  # fmt: skip
            text = output.read_text(encoding="latin-1") if output.exists() else ""
        return _read_gains(text, (ended.stderr or ended.stdout).strip().splitlines())


def _read_gains(text: str, said: list[str]) -> Array:
    """Gains by the fields at 1 m, G = 4 pi |E|^2 / (2 eta P)."""
    power_w, fields, inside = 0.0, [], False
    for line in text.splitlines():
        words = line.split()
        if "INPUT POWER" in line:
            power_w = float(words[words.index("=") + 1])
        elif "RADIATION PATTERNS" in line:
            inside = True
        elif inside and len(words) in (11, 12) and _is_number(words[0]):
            # SENSE is a word or, where there is no field, nothing
            fields.append((float(words[-4]), float(words[-2])))
        elif inside and words and not _is_number(words[0]) and words[0] not in {"----", "THETA", "DEGREES"}:
            inside = False
    if fields and power_w <= 0.0:
        raise NoPower(f"nec2c gave no pattern: its sources feed in {power_w:g} W")
    if not fields:
        raise Nec2cFailed(f"nec2c gave no pattern: {said[-1] if said else 'it said nothing'}")
    return np.asarray(np.array(fields) ** 2 * (4.0 * np.pi / (2.0 * ETA_NEC_OHM * power_w)))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

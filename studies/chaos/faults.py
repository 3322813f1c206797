"""The faults of the chaos study, and their plan."""

from typing import Literal

import numpy as np
from msgspec import Struct

Target = Literal["launcher", "physics", "radio", "prefork", "uav 0", "application 0", "px4 0", "disk"]
"""``application 0`` and ``px4 0`` are in flights whose autopilots are stand-ins for PX4."""
Kind = Literal[
    "SIGKILL", "SIGSEGV", "SIGTERM", "SIGHUP", "SIGINT", "SIGSTOP", "SIGSTOP for 2 s",
    "closed output", "closed terminal", "file limit", "full",
]  # fmt: skip
Phase = Literal["imports", "start", "flight", "pause", "stop", "report"]
TARGETS: tuple[Target, ...] = (
    "launcher", "physics", "radio", "prefork", "uav 0", "application 0", "px4 0", "disk",
)  # fmt: skip
KINDS: tuple[Kind, ...] = (
    "SIGKILL", "SIGSEGV", "SIGTERM", "SIGHUP", "SIGINT", "SIGSTOP", "SIGSTOP for 2 s",
    "closed output", "closed terminal", "file limit", "full",
)  # fmt: skip
PHASES: tuple[Phase, ...] = ("imports", "start", "flight", "pause", "stop", "report")
WITH_PX4 = ("application 0", "px4 0")
LONGEST_DELAY_S = {"imports": 0.6, "start": 0.3, "flight": 2.0, "pause": 1.0, "stop": 0.3, "report": 1.0}
"""Wall time between the begin of a phase and the fault, at most."""
LONGEST_AFTER_S = 1.0
"""Wall time between the first fault of a flight and its second, at most."""
_INTERRUPTS = ("SIGTERM", "SIGHUP", "SIGINT", "closed terminal")
_INTERRUPTIBLE = ("start", "flight", "pause")
"""Phases that an interrupt of the launcher turns into phase ``stop``."""
SINGLES = 4
"""Flights with one fault before each flight with two."""


class Second(Struct, frozen=True, kw_only=True):
    """A second fault of another process, ``after_s`` of wall time after the first."""

    target: Target
    kind: Kind
    after_s: float


class Fault(Struct, frozen=True, kw_only=True):
    """What happens to which process in which phase of a flight, ``delay_s`` of wall time after its begin."""

    target: Target
    kind: Kind
    phase: Phase
    delay_s: float
    second: Second | None = None

    @property
    def title(self) -> str:
        """One line without the delays."""
        second = "" if self.second is None else f", {self.second.kind} of {self.second.target}"
        return f"{self.kind} of {self.target}{second} in {self.phase}"

    @property
    def line(self) -> str:
        """One line with the delays."""
        second = "" if self.second is None else f" and {self.second.after_s:g} s"
        return f"{self.title} after {self.delay_s:g} s{second}"

    @property
    def parts(self) -> "tuple[Fault, ...]":
        """Both faults, each as the only one of a flight.

        A second fault after the launcher was interrupted is one in phase ``stop``.
        """
        alone = Fault(target=self.target, kind=self.kind, phase=self.phase, delay_s=self.delay_s)
        if self.second is None:
            return (alone,)
        second = self.second
        later_s = round(self.delay_s + second.after_s, 3)
        is_interrupted = self.target == "launcher" and self.kind in _INTERRUPTS
        phase: Phase = "stop" if is_interrupted and self.phase in _INTERRUPTIBLE else self.phase
        return alone, Fault(target=second.target, kind=second.kind, phase=phase, delay_s=later_s)


def is_possible(target: Target, kind: Kind, phase: Phase) -> bool:
    """Whether such a fault exists, and says something."""
    if (target == "disk") != (kind == "full"):
        return False
    if target == "disk":
        return phase != "imports"  # the run's folder is being made
    if target == "launcher":
        # one that is stopped for good waits to be continued
        return kind not in ("SIGSTOP", "file limit") and (
            kind != "closed output" or phase in ("flight", "report")
        )
    if kind in ("closed output", "closed terminal") or phase == "report":
        return False
    if target in WITH_PX4:
        return kind != "file limit" and phase in ("flight", "pause")
    if target == "uav 0" and phase == "imports":  # a fork imports nothing
        return False
    # only these write files, in flight
    return kind != "file limit" or (target in ("physics", "uav 0") and phase == "flight")


def plan(flights: int, seed: int) -> list[Fault]:
    """Draw the faults of a number of flights; equal seeds give equal faults, whatever the number.

    Each fifth flight has two faults, in which any combination may come. Of those with one fault, all possible
    combinations of process, fault and phase come once before any comes twice.
    """
    rng = np.random.default_rng([seed, 57])
    possible = [(t, k, p) for t in TARGETS for k in KINDS for p in PHASES if is_possible(t, k, p)]
    drawn: list[Fault] = []
    while len(drawn) < flights:
        for index in rng.permutation(len(possible)):
            if len(drawn) % (SINGLES + 1) == SINGLES:
                drawn.append(_two_faults(rng, possible))
            drawn.append(_one_fault(rng, *possible[index]))
    return drawn[:flights]


def _one_fault(rng: np.random.Generator, target: Target, kind: Kind, phase: Phase) -> Fault:
    delay_s = round(float(rng.uniform(0.0, LONGEST_DELAY_S[phase])), 3)
    return Fault(target=target, kind=kind, phase=phase, delay_s=delay_s)


def _two_faults(rng: np.random.Generator, possible: list[tuple[Target, Kind, Phase]]) -> Fault:
    """Draw two faults of different processes in one phase, without other autopilots and full disks.

    In phase ``report`` the launcher is alone.
    """
    own = [each for each in possible if each[0] not in (*WITH_PX4, "disk") and each[2] != "report"]
    target, kind, phase = own[int(rng.integers(len(own)))]
    others = [each for each in own if each[0] != target and each[2] == phase]
    first = _one_fault(rng, target, kind, phase)
    other, other_kind, _ = others[int(rng.integers(len(others)))]
    after_s = round(float(rng.uniform(0.0, LONGEST_AFTER_S)), 3)
    second = Second(target=other, kind=other_kind, after_s=after_s)
    return Fault(target=target, kind=kind, phase=phase, delay_s=first.delay_s, second=second)

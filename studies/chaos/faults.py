"""The faults of the chaos study, and how a flight with one of them has to end."""

import re
import signal
from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct

from foundation.exit_status import FAILED, FINE, INTERRUPTED

Target = Literal["launcher", "physics", "radio", "prefork", "uav 0"]
Kind = Literal[
    "SIGKILL", "SIGSEGV", "SIGTERM", "SIGHUP", "SIGINT", "SIGSTOP", "SIGSTOP for 2 s",
    "closed output", "file limit",
]  # fmt: skip
Phase = Literal["imports", "start", "flight", "pause", "stop", "report"]
TARGETS: tuple[Target, ...] = ("launcher", "physics", "radio", "prefork", "uav 0")
KINDS: tuple[Kind, ...] = (
    "SIGKILL", "SIGSEGV", "SIGTERM", "SIGHUP", "SIGINT", "SIGSTOP", "SIGSTOP for 2 s",
    "closed output", "file limit",
)  # fmt: skip
PHASES: tuple[Phase, ...] = ("imports", "start", "flight", "pause", "stop", "report")
DEATHS = ("SIGKILL", "SIGSEGV")
LONGEST_DELAY_S = {"imports": 0.6, "start": 0.3, "flight": 2.0, "pause": 1.0, "stop": 0.3, "report": 1.0}
"""Wall time between the begin of a phase and the fault, at most."""


class Fault(Struct, frozen=True, kw_only=True):
    """What happens to which process in which phase of a flight, ``delay_s`` of wall time after its begin."""

    target: Target
    kind: Kind
    phase: Phase
    delay_s: float

    @property
    def title(self) -> str:
        """One line."""
        return f"{self.kind} of {self.target} in {self.phase}"


def is_possible(target: Target, kind: Kind, phase: Phase) -> bool:
    """Whether such a fault exists, and says something."""
    if target == "launcher":
        # one that is stopped for good waits to be continued
        return kind not in ("SIGSTOP", "file limit") and (
            kind != "closed output" or phase in ("flight", "report")
        )
    if kind == "closed output" or phase == "report":
        return False
    if target == "uav 0" and phase == "imports":  # a fork imports nothing
        return False
    # only these write files, in flight
    return kind != "file limit" or (target in ("physics", "uav 0") and phase == "flight")


def plan(flights: int, seed: int) -> list[Fault]:
    """Draw the faults of a number of flights; equal seeds give equal faults, whatever the number.

    All possible combinations of process, fault and phase come once before any comes twice.
    """
    rng = np.random.default_rng([seed, 57])
    possible = [(t, k, p) for t in TARGETS for k in KINDS for p in PHASES if is_possible(t, k, p)]
    drawn: list[Fault] = []
    while len(drawn) < flights:
        for index in rng.permutation(len(possible)):
            target, kind, phase = possible[index]
            delay_s = round(float(rng.uniform(0.0, LONGEST_DELAY_S[phase])), 3)
            drawn.append(Fault(target=target, kind=kind, phase=phase, delay_s=delay_s))
    return drawn[:flights]


def statuses(fault: Fault) -> Sequence[int]:
    """Return the exit statuses that a flight with this fault may have.

    A launcher that was killed has the signal's. In phase ``stop`` the flight was interrupted before, and in
    ``report`` it may have ended.
    """
    if fault.kind in ("SIGSTOP for 2 s", "closed output"):
        return [INTERRUPTED] if fault.phase == "stop" else [FINE]
    if fault.target == "launcher":
        if fault.kind in DEATHS:
            killed = -signal.Signals[fault.kind]
            return [killed, FINE] if fault.phase == "report" else [killed]
        return [INTERRUPTED, FINE] if fault.phase == "report" else [INTERRUPTED]
    if fault.phase == "stop":
        return [INTERRUPTED, FAILED]
    if fault.target == "uav 0":  # once it has connected the run goes on without it
        return [FAILED, FINE] if fault.phase == "start" else [FINE]
    return [FAILED]


def named(fault: Fault) -> Sequence[str]:
    """Return texts of which the messages must have one; none: they need not name the process.

    A process by its name and id; one that was killed with the signal. A vehicle that is stopped is lost, by
    its name.
    """
    if fault.target == "launcher" or fault.kind == "SIGSTOP for 2 s" or fault.phase == "stop":
        return []
    name = re.escape(fault.target)
    if fault.kind in DEATHS:
        return [rf"{name} \(pid \d+\) was killed by {fault.kind}"]
    texts = [rf"{name} \(pid "]
    if fault.kind == "SIGSTOP":
        texts = [rf"{name} \(pid \d+\) is stopped \(SIGSTOP\)"]
        if fault.target == "uav 0":
            texts.append(rf"{name}( was)? lost")
    return texts

"""Response watchdog: decides how long to wait for a process that does not answer.

A machine under load starves processes for seconds, and the result of a run must not depend on that. Silence
therefore counts only while the process could have answered (`harness.simulator.process_activity`). A dead
process is given up at once, a stopped one after some seconds. Of one that is runnable but starved only its
processor time counts. Silence of one that sleeps or computes counts; but the sleep of a vehicle does not
while the 802.11 emulator has work, as it may owe the vehicle a delivery (`ResponseWatchdog.set_radio_pid`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import psutil

from harness.simulator.process_activity import (
    ENDED,
    STOPPED_LIMIT_S,
    Activity,
    ProcessState,
    has_work,
    state_of,
)

LOOK_AFTER_S = 0.25
"""Shorter silences are ignored; from then on the process is examined."""
REPORT_AFTER_S = 0.5
STARVED_REPORT_AFTER_S = 8.0
"""Silence of a process that gets no processor after which it is reported."""
STARTING_LIMIT_S = 120.0
"""Limit before a vehicle's first answer: it may be compiling its kernels. Such a silence is not reported."""
COMPUTING_LIMIT_S = 30.0
"""Least limit for a process that computes: an endless loop and a long computation look the same."""
_NO_SILENCES: Mapping[int, float] = {}
_UNKNOWN = ProcessState("unknown", 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class SilenceFinding:
    """Result of checking one silent vehicle."""

    wall_silence_s: float
    newly_silent: bool = False
    give_up: str | None = None
    """Reason to remove the vehicle; None: continue to wait."""


class ResponseWatchdog:
    """Decides on silent vehicles, or other processes with a number, by the state of their processes.

    A vehicle whose process id is unknown is given up after ``limit_s`` of silence. ``on_check`` is called
    with the wall time at each check, so it is called repeatedly while an answer is waited for.
    """

    def __init__(
        self,
        limit_s: float,
        *,
        stopped_limit_s: float = STOPPED_LIMIT_S,
        on_check: Callable[[float], object] = lambda _: None,
    ) -> None:
        self._limit_s = limit_s
        self._stopped_limit_s = stopped_limit_s
        self._on_check = on_check
        self._processes: dict[int, psutil.Process] = {}
        self._radio_pid: int | None = None
        self._wall_begin_s = 0.0
        self._since_s: Mapping[int, float] = _NO_SILENCES
        self._observations: dict[int, Activity] = {}
        self._reported: set[int] = set()

    def set_pid(self, instance: int, pid: int) -> None:
        """Set the process id of a vehicle; a process that does not exist counts as unknown."""
        try:
            self._processes[instance] = psutil.Process(pid)
        except psutil.NoSuchProcess:
            self._processes.pop(instance, None)

    def set_radio_pid(self, pid: int) -> None:
        """Set the process id of the 802.11 emulator, whose deliveries the vehicles wait for."""
        self._radio_pid = pid

    def begin(self, wall_s: float, *, silent_since_s: Mapping[int, float] = _NO_SILENCES) -> None:
        """Begin a wait for all vehicles; ``silent_since_s``: starts of silences that continue in it."""
        self._wall_begin_s = wall_s
        self._since_s = silent_since_s
        if silent_since_s:
            self._observations = {i: seen for i, seen in self._observations.items() if i in silent_since_s}
            self._reported &= silent_since_s.keys()
        elif self._observations:
            self._observations.clear()
            self._reported.clear()

    def check(self, instance: int, wall_s: float, *, starting: bool) -> SilenceFinding:
        """Decide on a vehicle that has not answered since `begin`; call this a few times per second."""
        self._on_check(wall_s)
        silence_s = wall_s - self._since_s.get(instance, self._wall_begin_s)
        if silence_s < LOOK_AFTER_S:
            return SilenceFinding(wall_silence_s=silence_s)
        state = self._process_state(instance)
        if state.status in ENDED:
            give_up = f"its process is {state.status}"
            return SilenceFinding(wall_silence_s=silence_s, newly_silent=True, give_up=give_up)
        seen = self._observations.get(instance)
        if seen is None:
            self._observations[instance] = Activity.begin(wall_s, state)
            return SilenceFinding(wall_silence_s=silence_s)
        seen.look(wall_s, state, held_up=self._is_radio_busy())
        report_after_s = STARVED_REPORT_AFTER_S if seen.starved else REPORT_AFTER_S
        newly = instance not in self._reported and not starting and silence_s >= report_after_s
        if newly:
            self._reported.add(instance)
        limit_s = STARTING_LIMIT_S if starting else self._limit_s
        reason = None
        if seen.stopped_s > self._stopped_limit_s:
            reason = f"its process is {state.status}"
            newly |= instance not in self._reported
        elif seen.waiting_s > limit_s or seen.computing_s > max(limit_s, COMPUTING_LIMIT_S):
            reason = f"it has not answered for {silence_s:.1f} s"
        return SilenceFinding(wall_silence_s=silence_s, newly_silent=newly, give_up=reason)

    def _is_radio_busy(self) -> bool:
        return self._radio_pid is not None and has_work(self._radio_pid)

    def _process_state(self, instance: int) -> ProcessState:
        process = self._processes.get(instance)
        return _UNKNOWN if process is None else state_of(process)

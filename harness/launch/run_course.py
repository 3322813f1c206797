"""The course of a run that its logs do not hold, and the outcome that follows from it."""

import sys
from datetime import UTC, datetime

from harness.launch import profiling
from harness.launch.process_commands import PHYSICS
from harness.launch.processes import Processes
from harness.records.outcome import RUNNING, ProcessRecord, RunOutcome
from harness.records.versions import Checkout, checkout

INTERRUPTED = "the run was interrupted by its user"
HELD = "the run was ended by its user"


class RunCourse:
    """Notes of a run from its start on."""

    def __init__(self) -> None:
        self.interventions: list[str] = []
        """At exact simulated times, by a program or user."""
        self.killed: set[int] = set()
        """Vehicles that were killed deliberately."""
        self.wall_running_s = 0.0
        """Wall time in which simulated time passed."""
        self.not_formed: str | None = None
        """Why the formation was not reached in time."""
        self.broken_off: str | None = None
        """Why a run method ended at a simulated time that depends on the machine."""
        self._started_utc = ""
        self._checkout: Checkout | None = None

    @property
    def has_begun(self) -> bool:
        """Whether `begin` was called."""
        return bool(self._started_utc)

    def begin(self) -> None:
        """Note the time and the state of the sources."""
        self._started_utc = datetime.now(UTC).isoformat(timespec="seconds")
        self._checkout = checkout()

    def break_off(self, error: BaseException) -> str:
        """Note the error that ended a run method; returns it as text."""
        if isinstance(error, KeyboardInterrupt):
            self.broken_off = INTERRUPTED
        else:
            self.broken_off = f"a run was broken off: {str(error) or type(error).__name__}"
        return self.broken_off

    def running(self, *, speed: float) -> RunOutcome:
        """Return what is known of the run before its end; ``speed``: see `RunOutcome`."""
        return RunOutcome(
            status=RUNNING,
            command=tuple(sys.argv),
            speed=speed,
            started_utc=self._started_utc,
            checkout=self._checkout,
            wall_s=None,
            simulated_us=None,
            formed_us=None,
            processes=(),
        )

    def ended(self, processes: Processes, *, speed: float, held: bool) -> RunOutcome:
        """Return the outcome after the end of all processes; ``held``: its user ended a hold."""
        failure, lost = processes.failure, processes.records_lost
        interrupted = self.broken_off == INTERRUPTED and not held
        nondeterminism = processes.nondeterminism(self.killed)
        if held or self.broken_off is not None:
            nondeterminism.append(HELD if held else self.broken_off or "")
        if (interrupted or held) and lost is None:
            status = "interrupted" if interrupted else "held"
        elif failure is not None:
            status = "failed"
        else:
            status = "completed" if self.not_formed is None else "not_formed"
        reasons = (self.not_formed,) if failure is None else (failure, lost)
        finished = processes.finished
        return RunOutcome(
            status=status,
            reason=None if status == "held" else "; ".join(dict.fromkeys(filter(None, reasons))) or None,
            command=tuple(sys.argv),
            speed=speed,
            started_utc=self._started_utc,
            checkout=self._checkout,
            wall_s=self.wall_running_s,
            simulated_us=finished.get(PHYSICS, {}).get("time_us", processes.simulated_us),
            formed_us=processes.formed_us,
            processes=tuple(
                ProcessRecord(
                    name=name, pid=exited.pid, ending=exited.describe(), details=finished.get(name, {})
                )
                for name, exited in sorted(processes.exited.items(), key=lambda item: item[1].pid)
            ),
            ground_messages=sum(details.get("ground_messages", 0) for details in finished.values()),
            interventions=tuple(self.interventions),
            nondeterminism=tuple(nondeterminism),
            profile=profiling.by_kind(finished),
        )

"""The messages of a run's processes, their ends, and what keeps the run from going on.

`harness.launch.processes` starts and stops the processes; this module receives what they send, looks at them
while it waits (`harness.launch.process_watch`), and describes how they ended (`harness.launch.death_report`).
"""

import contextlib
import signal
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import msgspec

from foundation.processes.child_protocol import Finished, Influenced, Ready
from harness.launch.death_report import is_full, memory_kills, recorded_bytes
from harness.launch.process_commands import NETWORK, PHYSICS, PREFORK, RADIO, application
from harness.launch.process_watch import LOOK_PERIOD_S, Finding, ProcessWatch
from harness.launch.run_messages import Message, ProcessNotice, RunEvent, SwarmError, SwarmTimeoutError
from harness.launch.supervisor import Exited, Supervisor, SupervisorError
from harness.records.run_folder import RunFolder
from harness.simulator.emulator_client import GONE, UNANSWERED
from harness.simulator.messages import ApplicationLost, Formed, Paused, Progress, Waiting
from netsim.network.messages import ProgramStarted

CAUSE_LIMIT_S = 0.3
"""Wall time after the end of a process within which that of another is found, which may be its cause."""
START_CAUSE_LIMIT_S = 1.5
"""The same for a vehicle or an application that ends in the start: an emulator that was interrupted closes
its connections before it ends."""


class RunMonitor:
    """What has arrived from the processes of ``supervisor``.

    ``starting`` are the processes, besides the indispensable ones, that are looked at until all vehicles have
    connected; those of them in ``until_connected`` must not end before. ``expendable`` are those whose end
    or stop does not end the run afterwards, each with a clause that states what follows; one that is stopped
    is killed, so that it does not go on with a part of the run missing. A call of a user's models may take
    ``call_limit_s`` of wall time. ``wall_limit_s`` limits the run's wall time from the start on, without the
    compilation of kernels; ``on_message`` receives every message that is taken from the queue, on the
    caller's thread.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        folder: RunFolder,
        *,
        starting: Collection[str],
        until_connected: Collection[str],
        expendable: Mapping[str, str],
        call_limit_s: float,
        wall_limit_s: float | None,
        on_message: Callable[[Message], None] | None,
    ) -> None:
        self._supervisor = supervisor
        self._folder = folder
        self._starting = starting
        self._until_connected = until_connected
        self._expendable = expendable
        self._wall_limit_s = wall_limit_s
        self._wall_start_s = time.monotonic()
        self._on_message = on_message or (lambda _: None)
        self._running = False
        """Whether the processes were started and not stopped."""
        self._connected = False
        """Whether every vehicle has connected to the physics server."""
        self.ready: dict[str, Ready] = {}
        self.finished: dict[str, dict[str, Any]] = {}
        """Details of each process's last event."""
        self.influences: list[Influenced] = []
        """Inputs from outside, which make the run depend on more than scenario and seed."""
        self.exited: dict[str, Exited] = {}
        self.events: list[RunEvent] = []
        """Events and ends of the processes, without progress and replies to commands."""
        self.simulated_us = 0
        self.wall_paused_s = 0.0
        """Wall time for which the present or last `RunUntil` was paused."""
        self.formed_us: int | None = None
        self.failure: str | None = None
        """Why no command can be executed any more, or that the records are incomplete."""
        self._descriptions: dict[str, str] = {}
        """A line for each process that has ended, or because of which the run has."""
        self._found: dict[str, Finding] = {}
        """Processes because of which the run cannot go on, though they have not ended."""
        self._watch = ProcessWatch(call_limit_s=call_limit_s)
        self._wall_look_s = 0.0
        """Time of the last look at the processes."""
        self._awaits_progress = False
        """Whether the physics server is to report what it does at least every second."""
        self._awaits_radio_end = False
        """Whether `cause_of` waits for the end of the radio."""
        self._memory_kills = memory_kills()

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return self._supervisor.pids

    def next(self, wall_limit_s: float, timeout_reason: str) -> Message:
        """Return the next message of any process within ``wall_limit_s``.

        Raises SwarmTimeoutError with the text ``timeout_reason``, or SwarmError if an indispensable process
        ended, is stopped or makes no progress.
        """
        if self._wall_limit_s is not None:
            left_s = self._wall_start_s + self._wall_limit_s - time.monotonic()
            if left_s < wall_limit_s:
                wall_limit_s = left_s
                timeout_reason = f"the wall time of {self._wall_limit_s:g} s is over"
        wall_end_s = time.monotonic() + wall_limit_s
        while True:
            left_s = wall_end_s - time.monotonic()
            message = self._take(min(left_s, LOOK_PERIOD_S))
            if message is None and left_s <= LOOK_PERIOD_S:
                raise self.fatal(SwarmTimeoutError(timeout_reason))
            if self.failure is not None:
                raise SwarmError(self.failure)
            self._look()
            if message is not None:
                return message

    @contextlib.contextmanager
    def progress_awaited(self) -> Iterator[None]:
        """Expect the physics server to report its progress in the block."""
        for name in (PHYSICS, RADIO):
            self._watch.on_progress(name)
        self._awaits_progress = True
        try:
            yield
        finally:
            self._awaits_progress = False

    def _look(self) -> None:
        """Look at the processes, a few times per second. Raises SwarmError if one holds up the run."""
        wall_s = time.monotonic()
        if wall_s - self._wall_look_s < LOOK_PERIOD_S:
            return
        self._wall_look_s = wall_s
        expendable = self._expendable.keys() - self._descriptions.keys()
        names = [
            PHYSICS,
            RADIO,
            PREFORK,
            NETWORK,
            *(sorted(expendable) if self._connected else self._starting),
        ]
        progressing = [PHYSICS] if self._awaits_progress else []
        stepping = [RADIO] if self._awaits_progress and self._connected else []
        states = self._supervisor.states(names)
        found = self._watch.look(wall_s, states, progressing=progressing, stepping=stepping)
        if found is not None:
            line = f"{found.name} (pid {self.pids[found.name]}) {found.what} {self._when()}"
            if not found.given_up:
                self._on_message(ProcessNotice(text=line))
                return
            if self._connected and found.name in self._expendable:
                self._give_up(found.name, line)
                return
            self._found[found.name] = found
            if not found.is_stopped:
                line += f" (traces of its threads: {self._supervisor.log_path(found.name)})"
            self._descriptions[found.name] = line
            self._on_message(ProcessNotice(text=f"{line}: the run ends"))
            raise self.fatal(SwarmError(line))

    def _give_up(self, name: str, line: str) -> None:
        """Kill a process that is stopped, which ``line`` states, and without which the run goes on."""
        self._descriptions[name] = line
        self._on_message(ProcessNotice(text=f"{line}: it is killed, and {self._expendable[name]}"))
        with contextlib.suppress(SupervisorError):
            self._supervisor.kill(name)

    def _kill_found(self) -> None:
        """Kill what was found to be stopped or to hang; of what hangs, with a trace in its log.

        Not the prefork server: it holds no records, and the vehicles would end with it.
        """
        for name, finding in self._found.items():
            if name != PREFORK and self._supervisor.alive(name):
                with contextlib.suppress(SupervisorError):
                    self._supervisor.kill(name, after_trace=not finding.is_stopped)

    def find_cause(self) -> None:
        """Process the messages of the next moments until the end of an indispensable process is one of them.

        What ends a run may be the consequence of an end that is reported a little later.
        """
        wall_end_s = time.monotonic() + CAUSE_LIMIT_S
        while self.failure is None and (left_s := wall_end_s - time.monotonic()) > 0.0:
            self._take(left_s)

    def failed_processes(self) -> list[str]:
        """Return a line for each process that failed, in order."""
        self.drain()
        return [self._descriptions[name] for name, exited in self.exited.items() if exited.returncode]

    def drain(self) -> None:
        """Process all messages that have arrived."""
        while self._take(0.0) is not None:
            pass

    def note_failure(self, reason: str) -> None:
        """Store why the run failed, unless an earlier reason is stored."""
        if self.failure is None:
            self.failure = reason

    def fatal(self, error: SwarmError) -> SwarmError:
        """Store why the run cannot continue; returns the error, to be raised."""
        self.failure = str(error)
        return error

    def _take(self, wall_limit_s: float) -> Message | None:
        received = self._supervisor.receive(wall_limit_s)
        if received is None:
            return None
        name, message = received
        if isinstance(message, Exited):
            message = self._with_sequel(message)
        if name == PHYSICS:
            self._watch.on_progress(PHYSICS)
        match message:
            case Ready():
                self.ready[name] = message
            case Finished():
                self.finished[name] = message.details
            case Influenced():
                self.influences.append(message)
            case Progress() | Paused():
                self._connected = True
                stands = isinstance(message, Paused) or message.paused
                if stands or message.time_us > self.simulated_us:
                    self._watch.on_progress(RADIO)
                self.simulated_us = message.time_us
                self.wall_paused_s = message.wall_paused_s
            case Waiting() | ProgramStarted():
                pass
            case _:
                self.events.append(message)
        if isinstance(message, ApplicationLost) and self._supervisor.alive(application(message.instance)):
            # it hangs: its radio, which it does not read, would block the emulator
            self._supervisor.kill(application(message.instance))
        if isinstance(message, Formed):
            self.formed_us = message.time_us
        elif isinstance(message, Exited):
            self.exited[name] = message
            self._descriptions.setdefault(name, self._describe_end(message))
            if self._is_needed(name) and self._running and self.failure is None:
                self.failure = self.cause_of(name, message)
        self._on_message(message)
        return message

    def _with_sequel(self, exited: Exited) -> Exited:
        """Return the end of a process without which the run goes on, with its time and what follows."""
        name = exited.name
        if name not in self._expendable or name in self._descriptions:
            return exited
        if self.failure is not None or not self._running:
            return exited
        sequel = f"{self._when()}, and {self._expendable[name]}" if self._connected else self._when()
        return msgspec.structs.replace(exited, sequel=sequel)

    def _is_needed(self, name: str) -> bool:
        """Whether the run fails if that process ends: another autopilot's until all have connected, too."""
        return name in (PHYSICS, RADIO, PREFORK, NETWORK) or (
            not self._connected and name in self._until_connected
        )

    def cause_of(self, name: str, exited: Exited) -> str:
        """Return a line for the end of a process that is needed, or for that of the radio, its cause."""
        if name not in (PHYSICS, RADIO, PREFORK, NETWORK):
            limit_s = START_CAUSE_LIMIT_S
        else:
            limit_s = CAUSE_LIMIT_S if name == PHYSICS and GONE in exited.last_words else 0.0
        if limit_s and not self._awaits_radio_end:
            self._awaits_radio_end = True  # meanwhile other processes may end for the same reason
            wall_end_s = time.monotonic() + limit_s
            while RADIO not in self.exited and (left_s := wall_end_s - time.monotonic()) > 0.0:
                self._take(left_s)
            self._awaits_radio_end = False
            if RADIO in self.exited:
                return self._descriptions[RADIO]
        elif name == PHYSICS and UNANSWERED in exited.last_words:
            for radio, state in self._supervisor.states([RADIO]).items():
                self._found[radio] = Finding(radio, "does not answer physics", state.status)
        return self._descriptions[name]

    def _describe_end(self, exited: Exited) -> str:
        """Return a line: the process, how it ended, when, why, and where its log is."""
        line, words = exited.describe(), exited.last_words
        log = f"(log: {self._supervisor.log_path(exited.name)})"
        if exited.sequel:
            line += f" {exited.sequel}"
        elif exited.returncode is None or exited.returncode < 0:
            line += f" {self._when()}"
        if exited.returncode is None or exited.returncode < 0:
            if exited.returncode == -signal.SIGKILL and memory_kills() > self._memory_kills:
                line += ", perhaps for lack of memory: the kernel killed processes for it during the run"
            return f"{line}: {words} {log}" if words else f"{line} {log}"
        full = is_full(self._folder.raw, words) if exited.returncode else None
        if full is not None:
            return f"{line}: {full} {self._folder.path}: {self._recorded()}"
        return f"{line}: {words} {log}" if words else line

    def _when(self) -> str:
        """Return the present simulated time, or the part of the run outside of it, for a sentence."""
        if not self._running:
            return "while the run was being stopped"
        return f"at {self.simulated_us * 1e-6:.3f} s" if self._connected else "during the start"

    def _recorded(self) -> str:
        """Return what of the run is readable, after its disk is full."""
        megabytes = recorded_bytes(self._folder.raw) / 1e6
        return f"{megabytes:.1f} MB recorded until {self.simulated_us * 1e-6:.1f} s are readable"

    def log_tails(self, lines: int) -> dict[str, str]:
        """Return the last lines of each process's log, by name."""
        return {name: self._supervisor.log_tail(name, lines) for name in self.pids}

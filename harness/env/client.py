"""The environment's end of the server and of the present episode: starts, steps and ends them."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import weakref
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from autopilot.parameters.onboard_config import OnboardConfig
from foundation.processes.message_stream import MessageStream
from harness.env.messages import (
    Ended,
    Failed,
    Fork,
    Forked,
    FromServer,
    Ready,
    Reap,
    Reply,
    Step,
    Stepped,
    ToServer,
)
from harness.env.server import MOST_BYTES
from harness.env.settings import EnvSettings
from harness.launch import kernel_cache
from harness.launch.process_commands import bound_module
from harness.launch.run_messages import SwarmError
from harness.launch.spawner import spawn
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load

APPLICATION = "harness.env.application:EnvApplication"
HOVER_LIMIT_S = 600.0
"""Wall time within which the swarm must hover."""
ANSWER_LIMIT_S = 60.0
"""Wall time within which an episode must answer."""
END_LIMIT_S = 5.0
_ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
_answers = msgspec.msgpack.Decoder(FromServer)


def env_scenario(
    scenario: str | Path | Scenario,
    settings: EnvSettings,
    *,
    agents: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
) -> Scenario:
    """Return a scenario with the environment's application in place of its own; other programs stay.

    Arguments as of `harness.launch.swarm.Swarm`. Raises ScenarioError.
    """
    if isinstance(scenario, Scenario):
        if agents is not None or seed is not None or overrides:
            raise ValueError("agents, seed and overrides change a scenario file; change a Scenario yourself")
    else:
        named = {"agents": agents, "run.seed": seed}
        values = [f"{path}={value}" for path, value in named.items() if value is not None]
        scenario = load(scenario, [*overrides, *values])
    own = scenario.onboard
    external = [i for i in range(scenario.agents) if scenario.autopilot.is_external(i)]
    if external:
        raise ScenarioError(
            f"autopilot.kind: UAV {external[0]} has another program as its autopilot; expected own for all "
            "UAVs of an environment"
        )
    onboard = OnboardConfig(
        application=APPLICATION, settings=msgspec.to_builtins(settings), folder=own.folder, port=own.port,
        programs=own.programs, loop_period_ms=own.loop_period_ms,
    )  # fmt: skip
    return msgspec.structs.replace(scenario, onboard=onboard)


class _Processes:
    """What is to be ended: the server and the sockets."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.server: subprocess.Popen[bytes] | None = None
        self.line: socket.socket | None = None
        self.episode: socket.socket | None = None

    def end(self) -> None:
        """Close the sockets, which ends the episode and the server, and wait; harmless when repeated."""
        for each in (self.episode, self.line):
            if each is not None:
                each.close()
        self.episode = self.line = None
        if self.server is None or os.getpid() != self.owner:  # a fork of the user's program has copies only
            return
        try:
            self.server.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self.server.kill()
            self.server.wait()
        self.server = None


class Client:
    """Server and episodes of one environment, for one thread; started by the first `reset`.

    They end with `close`, with this object and with the process.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._processes = _Processes()
        self._finalizer = weakref.finalize(self, self._processes.end)
        self._stream: MessageStream[Step, Reply] | None = None
        self._pid = 0

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the server and of the present episode; none before the first `reset`."""
        server = self._processes.server
        return () if server is None else (server.pid, self._pid)

    def reset(self, seed: int) -> Stepped:
        """Fork an episode and return its first state. Raises SwarmError, CompileError."""
        line = self._processes.line or self._start()
        if self._processes.episode is not None:
            self._processes.episode.close()
        own, theirs = socket.socketpair()
        self._processes.episode, self._stream = own, MessageStream(own, Reply, limit_s=ANSWER_LIMIT_S)
        with theirs:
            socket.send_fds(line, [_packed(Fork(seed))], [theirs.fileno()])
        answer = self._receive(line)
        if not isinstance(answer, Forked):
            raise SwarmError(f"env: no episode could be forked: {answer}")
        self._pid = answer.pid
        return self._stepped()

    def step(self, actions: NDArray[np.float64]) -> Stepped:
        """Apply actions (N, A) for one period. Raises SwarmError."""
        if self._stream is None:
            raise SwarmError("env: reset comes before step")
        self._stream.send(Step(actions.tobytes()))
        return self._stepped()

    def close(self) -> None:
        """End all processes; harmless when repeated. A `reset` starts them again."""
        self._stream = None
        self._processes.end()

    def _start(self) -> socket.socket:
        """Start the server and wait until the swarm hovers."""
        kernel_cache.prepare(_note)
        own, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        own.settimeout(HOVER_LIMIT_S)
        with theirs:
            self._processes.server = spawn(
                bound_module("harness.env.server", str(theirs.fileno())),
                pass_fds=(theirs.fileno(),), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                env=os.environ | kernel_cache.environment() | _ONE_THREAD | {"PYTHONPATH": _search_path()},
                process_group=0,  # Ctrl-C reaches this process only
            )  # fmt: skip
        self._processes.line = own
        own.send(msgspec.json.encode(self._scenario))
        answer = self._receive(own)
        if not isinstance(answer, Ready):
            self.close()
            raise SwarmError(f"env: {answer.text if isinstance(answer, Failed) else answer}")
        return own

    def _receive(self, line: socket.socket) -> FromServer:
        """Return the server's next answer. Raises SwarmError if it has ended or does not answer."""
        try:
            packet = line.recv(MOST_BYTES)
        except TimeoutError:
            self.close()
            raise SwarmError("env: the server of the swarm does not answer") from None
        except ConnectionResetError:
            packet = b""
        if packet:
            answer: FromServer = _answers.decode(packet)
            return answer
        server = self._processes.server
        status = 0 if server is None else server.wait()
        self.close()
        raise SwarmError(f"env: the server of the swarm {in_words(status)}")

    def _stepped(self) -> Stepped:
        stream, line = self._stream, self._processes.line
        if stream is None or line is None:
            raise SwarmError("env: closed")
        try:
            answer = stream.receive()
        except TimeoutError:
            os.kill(self._pid, signal.SIGKILL)
            self._end_episode()
            raise SwarmError(
                f"env: the episode's process {self._pid} has not answered for {ANSWER_LIMIT_S:g} s"
            ) from None
        if answer is not None and answer.stepped is not None:
            return answer.stepped
        self._end_episode()
        if answer is not None:
            raise SwarmError(f"env: the episode's process {self._pid} failed: {answer.failure}")
        with contextlib.suppress(BrokenPipeError):
            line.send(_packed(Reap(self._pid)))
        end = self._receive(line)
        words = in_words(end.returncode) if isinstance(end, Ended) else str(end)
        raise SwarmError(f"env: the episode's process {self._pid} {words}")

    def _end_episode(self) -> None:
        if self._processes.episode is not None:
            self._processes.episode.close()
        self._processes.episode = self._stream = None


def in_words(status: int) -> str:
    """Return what became of a process with an exit status, or minus the signal that killed it."""
    if status >= 0:
        return f"has ended with status {status}"
    try:
        return f"was killed by {signal.Signals(-status).name}"
    except ValueError:
        return f"was killed by signal {-status}"


def _note(text: str) -> None:
    sys.stderr.write(f"coflight: {text}\n")


def _packed(request: ToServer) -> bytes:
    return msgspec.msgpack.encode(request)


def _search_path() -> str:
    """Return the search path of this process's modules, which the scenario's programs may be in."""
    return os.pathsep.join(path for path in sys.path if path)

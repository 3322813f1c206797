"""``python -m harness.env.server``: flies a swarm to its places once, and forks a process for each episode.

Its first packet on the inherited socket is the scenario, as JSON; it answers `Ready` or `Failed`, and then
`Fork`, which comes with the episode's socket, and `Reap`. It ends when the environment closes the socket, and
with it all episodes.
"""

import contextlib
import gc
import os
import socket
import sys
import traceback
from pathlib import Path

import msgspec
import numpy as np

from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from foundation.processes.message_stream import MessageStream
from foundation.processes.parent_death import end_with_parent_process
from foundation.processes.prefork import show_name
from foundation.system_error import described
from harness.env.application import EnvApplication
from harness.env.episode import Episode
from harness.env.messages import Ended, Failed, Fork, Forked, FromServer, Ready, Reply, Step, ToServer
from harness.env.settings import EnvSettings
from harness.launch.run_messages import SwarmError
from harness.scenario.scenario import Scenario

NAME = "env server"
MOST_BYTES = 1 << 20
"""Longest packet."""
_requests = msgspec.msgpack.Decoder(ToServer)


def main() -> int:
    """Serve an environment; returns the exit status."""
    show_name(NAME)
    with socket.socket(fileno=int(sys.argv[1])) as line:
        scenario = msgspec.json.decode(line.recv(MOST_BYTES), type=Scenario)
        try:
            EnvApplication.warm_up()
            episode = Episode(scenario, msgspec.convert(scenario.onboard.settings, EnvSettings))
            episode.hover()
            check_single_thread()
        except (ExtensionError, ExtensionFailure, SwarmError, ValueError) as error:
            _answer(line, Failed(str(error)))
            return 2
        except Exception as error:  # noqa: BLE001  a fault of coflight
            traceback.print_exc()
            _answer(line, Failed(described(error)))
            return 1
        # a collection in a forked process would copy every page of what is older than it
        gc.collect()
        gc.freeze()
        _answer(line, Ready(episode.time_us * 1e-6))
        _serve(line, episode)
    return 0


def check_single_thread() -> None:
    """Raise SwarmError if this process has several threads: a forked one lacks them, but not their locks."""
    threads = sorted(path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm"))
    if len(threads) > 1:
        raise SwarmError(
            f"the process of the swarm has {len(threads)} threads ({', '.join(threads)}), so it cannot be "
            "forked: the scenario's programs and models must not start any"
        )


def _serve(line: socket.socket, episode: Episode) -> None:
    server = os.getpid()
    while True:
        packet, fds, _, _ = socket.recv_fds(line, MOST_BYTES, 1)
        if not packet:
            return
        request = _requests.decode(packet)
        if isinstance(request, Fork):
            _reap()
            try:
                pid = os.fork()
            except OSError as error:
                pid = -1
                _answer(line, Failed(described(error)))
            if pid == 0:
                line.close()
                _run(episode, request.seed, fds[0], server)
            os.close(fds[0])
            if pid > 0:
                _answer(line, Forked(pid))
        else:
            _answer(line, Ended(os.waitstatus_to_exitcode(os.waitpid(request.pid, 0)[1])))


def _reap() -> None:
    """Reap the earlier episodes that have ended; that of the environment's last fork is not asked for."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass


def _answer(line: socket.socket, answer: FromServer) -> None:
    with contextlib.suppress(OSError):  # the environment may have ended
        line.send(msgspec.msgpack.encode(answer))


def _run(episode: Episode, seed: int, descriptor: int, server: int) -> None:
    """Run an episode in its forked process; does not return."""
    status = 1
    try:
        end_with_parent_process(server)
        show_name("env episode")
        with socket.socket(fileno=descriptor) as connection:
            _follow(episode, seed, MessageStream(connection, Step, limit_s=None))
        status = 0
    except BaseException:  # noqa: BLE001  reported as by the interpreter
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()
        os._exit(status)  # the frames below belong to the server


def _follow(episode: Episode, seed: int, stream: MessageStream[Reply, Step]) -> None:
    try:
        stream.send(Reply(episode.begin(seed)))
        while (step := stream.receive()) is not None:
            actions = np.frombuffer(step.actions).reshape(episode.agents, -1)
            stream.send(Reply(episode.step(actions)))
    except Exception as error:
        stream.send(Reply(None, described(error)))
        raise


if __name__ == "__main__":
    sys.exit(main())

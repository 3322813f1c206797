"""Processes forked from a child are children like the others: messages, report of their end, end with all."""

import contextlib
import os
import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import WALL_LIMIT_S, alive, launcher_and_children, python, receive, wait_for

from foundation.processes.child_protocol import Finished, Ready
from harness.launch.supervisor import Exited, Supervisor, SupervisorError
from harness.simulator.messages import SetPid

pytestmark = pytest.mark.multiprocess

FORKER = """
    import faulthandler, os, queue, signal, socket, sys
    from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit, end_with_parent
    from foundation.processes.prefork import serve

    def polite(name):
        inbox = queue.SimpleQueue()
        commands(object, inbox)
        fds = sorted(int(fd) for fd in os.listdir("/proc/self/fd") if os.path.exists("/proc/self/fd/" + fd))
        emit(Ready(name=name, pid=os.getpid(), details={
            "fds": fds, "group": os.getpgid(0), "mark": os.environ["COFLIGHT_CHILD"], "parent": os.getppid(),
        }))
        first = inbox.get()
        emit(Finished(name=name, details=first))
        return 0

    def stubborn(name):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        emit(Ready(name=name, pid=os.getpid()))
        while True:
            signal.pause()

    def main(arguments):
        match arguments:
            case ["polite", name]:
                return polite(name)
            case ["stubborn", name]:
                stubborn(name)
            case ["returns", status]:
                print("a printing library")
                return int(status)
            case ["exits", reason]:
                sys.exit(reason)
            case ["raises", reason]:
                raise LookupError(reason)
            case ["crashes"]:
                os.kill(os.getpid(), signal.SIGSEGV)

    if "nothing" in sys.argv:
        sys.exit("forker: there is nothing to fork")
    if "refused" in sys.argv:
        def refuse():
            raise BlockingIOError(11, "Resource temporarily unavailable")
        os.fork = refuse
    emit(Ready(name="forker", pid=os.getpid()))
    serve(socket.socket(fileno=int(sys.argv[-1])), main)
    emit(Finished(name="forker"))
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    supervisor = Supervisor(tmp_path)
    supervisor.start_forker("forker", python(FORKER))
    receive(supervisor, Ready, "forker")
    yield supervisor
    supervisor.stop()
    assert supervisor.strays() == []


def test_fork_has_its_own_group_streams_name_and_mark_only(
    supervisor: Supervisor,
) -> None:
    pid = supervisor.fork("uav 3", ["polite", "uav 3"], forker="forker")
    ready = receive(supervisor, Ready, "uav 3")
    assert isinstance(ready, Ready)
    assert ready.pid == pid == ready.details["group"]
    assert ready.details == {
        "fds": [0, 1, 2],
        "group": pid,
        "mark": f"{supervisor.token}/uav 3",
        "parent": supervisor.pids["forker"],
    }
    assert psutil.Process(pid).name() == "uav 3"
    assert supervisor.alive("uav 3")
    assert [name for process, name in supervisor.strays() if process.pid == pid] == ["uav 3"]
    supervisor.send("uav 3", SetPid(instance=3, pid=1))
    finished = receive(supervisor, Finished, "uav 3")
    assert isinstance(finished, Finished)
    assert finished.details["instance"] == 3
    exited = receive(supervisor, Exited, "uav 3")
    assert exited == Exited(name="uav 3", pid=pid, returncode=0, log_tail="")
    assert not psutil.pid_exists(pid)


@pytest.mark.parametrize(
    ("arguments", "ending", "last_words"),
    [
        (["returns", "0"], "ended with status 0", ""),
        (["returns", "3"], "ended with status 3", "a printing library"),
        (["exits", "no such airframe"], "ended with status 1", "no such airframe"),
        (["raises", "where is up"], "ended with status 1", "LookupError: where is up"),
        (["crashes"], "was killed by SIGSEGV (segmentation fault)", ""),
    ],
)
def test_end_and_last_words_of_a_fork_are_reported(
    supervisor: Supervisor, arguments: list[str], ending: str, last_words: str
) -> None:
    pid = supervisor.fork("uav 7", arguments, forker="forker")
    exited = receive(supervisor, Exited, "uav 7")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 7 (pid {pid}) {ending}"
    assert exited.log_tail.endswith(last_words)
    assert supervisor.alive("forker")


def test_kill_returns_after_the_end_of_the_fork_and_others_continue(supervisor: Supervisor) -> None:
    pids = [supervisor.fork(f"uav {i}", ["polite", f"uav {i}"], forker="forker") for i in range(3)]
    assert {receive_ready(supervisor) for _ in pids} == {"uav 0", "uav 1", "uav 2"}
    began_s = time.monotonic()
    supervisor.kill("uav 1")
    assert time.monotonic() - began_s < 1.0
    assert [psutil.pid_exists(pid) for pid in pids] == [True, False, True]
    exited = receive(supervisor, Exited, "uav 1")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 1 (pid {pids[1]}) was killed by SIGKILL"
    # no process forked meanwhile holds the other ends of their pipes open
    assert supervisor.end(["uav 0", "uav 2"]) == []


def test_forks_that_end_at_once_do_not_block_further_forks(supervisor: Supervisor) -> None:
    began_s = time.monotonic()
    names = [f"uav {i}" for i in range(40)]
    for i, name in enumerate(names):
        supervisor.fork(name, ["returns", str(i % 2)], forker="forker")
    messages = [supervisor.receive(WALL_LIMIT_S) for _ in names]
    assert time.monotonic() - began_s < WALL_LIMIT_S
    ends = {
        message[0]: message[1].returncode
        for message in messages
        if message and isinstance(message[1], Exited)
    }
    assert ends == {name: i % 2 for i, name in enumerate(names)}


def test_stop_ends_all_forks_and_kills_those_that_ignore_it(supervisor: Supervisor) -> None:
    supervisor.fork("uav 0", ["polite", "uav 0"], forker="forker")
    pid = supervisor.fork("uav 1", ["stubborn", "uav 1"], forker="forker")
    assert {receive_ready(supervisor), receive_ready(supervisor)} == {"uav 0", "uav 1"}
    forced = supervisor.stop()
    # the forker waits for its forks, to report their status
    forker = f"forker (pid {supervisor.pids['forker']})"
    assert forced[:2] == [
        f"{forker} did not end in time: SIGTERM",
        f"uav 1 (pid {pid}) did not end in time: SIGTERM",
    ]
    assert not any(alive(pid) for pid in supervisor.pids.values())


def test_forks_end_with_a_killed_forker_without_an_exit_status(supervisor: Supervisor) -> None:
    pid = supervisor.fork("uav 0", ["polite", "uav 0"], forker="forker")
    receive(supervisor, Ready, "uav 0")
    os.kill(supervisor.pids["forker"], signal.SIGKILL)
    exited = receive(supervisor, Exited, "forker")
    assert isinstance(exited, Exited)
    assert exited.returncode == -signal.SIGKILL
    with pytest.raises(SupervisorError, match=r"^uav 1: cannot be forked by forker: "):
        supervisor.fork("uav 1", ["polite", "uav 1"], forker="forker")
    exited = receive(supervisor, Exited, "uav 0")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 0 (pid {pid}) ended with unknown status"
    assert supervisor.stop() == []


def test_failed_forker_and_failed_fork_are_one_line_each(tmp_path: Path) -> None:
    supervisor = Supervisor(tmp_path)
    try:
        pid = supervisor.start_forker("forker", [*python(FORKER), "nothing"])
        exited = receive(supervisor, Exited, "forker")
        assert exited == Exited(
            name="forker",
            pid=pid,
            returncode=1,
            log_tail="forker: there is nothing to fork",
            last_words="forker: there is nothing to fork",
        )
        supervisor.start_forker("another", [*python(FORKER), "refused"])
        for name in ("uav 0", "uav 1"):  # the forker continues
            with pytest.raises(SupervisorError, match=f"^{name}: cannot be forked by another: .*unavailable"):
                supervisor.fork(name, ["polite", name], forker="another")
    finally:
        supervisor.stop()


def own_threads() -> set[int]:
    return {thread.id for thread in psutil.Process().threads()}


def own_descriptors() -> set[tuple[str, str]]:
    """Return number and file of each descriptor."""
    found = set()
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # that of this listing
            found.add((path.name, str(path.readlink())))
    return found


def test_64_forks_need_two_descriptors_each_no_threads_and_little_time(supervisor: Supervisor) -> None:
    before, threads, count = own_descriptors(), own_threads(), 64
    began_s = time.process_time()
    names = [f"uav {i}" for i in range(count)]
    pids = [supervisor.fork(name, ["polite", name], forker="forker") for name in names]
    assert time.process_time() - began_s < 1.0
    ready = {receive_ready(supervisor) for _ in names}
    assert ready == set(names)
    # stdin and stdout; sockets of earlier tests may be closed meanwhile, by threads of libraries
    assert len(own_descriptors() - before) == 2 * count
    assert own_threads() <= threads  # threads of earlier tests may end
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert psutil.Process(supervisor.pids["forker"]).num_fds() < count + 16 < limit
    assert supervisor.end(names) == []
    assert not any(psutil.pid_exists(pid) for pid in pids)
    # and closes them
    wait_for(lambda: own_descriptors() <= before, "descriptors of children that have ended")


def test_end_continues_processes_stopped_by_sigstop(supervisor: Supervisor) -> None:
    """A stopped forker cannot report the status of its forks, and would delay the end of all."""
    names = ["uav 0", "uav 1", "uav 2"]
    for name in names:
        supervisor.fork(name, ["polite", name], forker="forker")
    assert {receive_ready(supervisor) for _ in names} == set(names)
    os.kill(supervisor.pids["forker"], signal.SIGSTOP)
    supervisor.kill("uav 0")
    for name in ("forker", "uav 1"):
        os.kill(supervisor.pids[name], signal.SIGSTOP)
    began_s = time.monotonic()
    assert supervisor.end(["uav 1", "uav 2"], grace_s=WALL_LIMIT_S) == []
    assert supervisor.stop() == []
    assert time.monotonic() - began_s < WALL_LIMIT_S / 4
    ends = {}
    while (message := supervisor.receive(0.0)) is not None:
        if isinstance(message[1], Exited):
            ends[message[0]] = message[1].returncode
    assert ends == {"uav 0": -signal.SIGKILL, "uav 1": 0, "uav 2": 0, "forker": 0}


def test_stopped_forker_is_named_instead_of_waited_for(supervisor: Supervisor) -> None:
    pid = supervisor.pids["forker"]
    os.kill(pid, signal.SIGSTOP)
    ending = rf"^uav 0: cannot be forked by forker: its process \(pid {pid}\) is stopped$"
    with pytest.raises(SupervisorError, match=ending):
        supervisor.fork("uav 0", ["polite", "uav 0"], forker="forker")
    assert supervisor.stop() == []


def test_forks_killed_with_their_forker_are_reported(supervisor: Supervisor) -> None:
    """The launcher itself waits for each fork of a killed forker."""
    names = [f"uav {i}" for i in range(8)]
    pids = [supervisor.fork(name, ["polite", name], forker="forker") for name in names]
    assert {receive_ready(supervisor) for _ in names} == set(names)
    os.kill(supervisor.pids["forker"], signal.SIGSTOP)
    for pid in pids[::2]:
        os.kill(pid, signal.SIGKILL)
    os.kill(supervisor.pids["forker"], signal.SIGKILL)
    ends = {}
    while len(ends) < 1 + len(pids):
        message = supervisor.receive(WALL_LIMIT_S)
        assert message is not None
        if isinstance(message[1], Exited):
            ends[message[0]] = message[1].returncode
    assert ends == dict.fromkeys(names) | {"forker": -signal.SIGKILL}
    assert supervisor.stop() == []


def receive_ready(supervisor: Supervisor) -> str:
    """Return the name of the next child that reports Ready."""
    message = supervisor.receive(WALL_LIMIT_S)
    assert message is not None
    assert isinstance(message[1], Ready)
    return message[0]


LAUNCHER = """
    supervisor.start_forker("forker", [sys.executable, "-c", sys.argv[2]])
    for i in range(3):
        supervisor.fork(f"uav {i}", ["polite", f"uav {i}"], forker="forker")
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_fork_outlives_the_launcher(tmp_path: Path, number: signal.Signals) -> None:
    pids = launcher_and_children(LAUNCHER, FORKER, tmp_path, ends_by=number)
    assert len(pids) == 4

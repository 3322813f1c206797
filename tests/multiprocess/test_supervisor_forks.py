"""What is forked from a child is a child like the others: heard, named when it ends, gone when all are."""

import os
import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import WALL_LIMIT_S, alive, hear, launcher_and_children, python, wait_for

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
    hear(supervisor, Ready, "forker")
    yield supervisor
    supervisor.stop()
    assert supervisor.strays() == []


def test_it_has_a_group_streams_a_name_and_a_mark_of_its_own_and_nothing_else(
    supervisor: Supervisor,
) -> None:
    pid = supervisor.fork("uav 3", ["polite", "uav 3"], forker="forker")
    ready = hear(supervisor, Ready, "uav 3")
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
    finished = hear(supervisor, Finished, "uav 3")
    assert isinstance(finished, Finished)
    assert finished.details["instance"] == 3
    exited = hear(supervisor, Exited, "uav 3")
    assert exited == Exited(name="uav 3", pid=pid, returncode=0, log_tail="")
    assert not psutil.pid_exists(pid)


@pytest.mark.parametrize(
    ("arguments", "ending", "last_words"),
    [
        (["returns", "0"], "ended with status 0", ""),
        (["returns", "3"], "ended with status 3", "a printing library"),
        (["exits", "no such airframe"], "ended with status 1", "no such airframe"),
        (["raises", "where is up"], "ended with status 1", "LookupError: where is up"),
        (["crashes"], "was killed by SIGSEGV", ""),
    ],
)
def test_its_end_and_last_words_are_told(
    supervisor: Supervisor, arguments: list[str], ending: str, last_words: str
) -> None:
    pid = supervisor.fork("uav 7", arguments, forker="forker")
    exited = hear(supervisor, Exited, "uav 7")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 7 (pid {pid}) {ending}"
    assert exited.log_tail.endswith(last_words)
    assert supervisor.alive("forker")


def test_kill_returns_when_it_is_gone_and_the_others_live(supervisor: Supervisor) -> None:
    pids = [supervisor.fork(f"uav {i}", ["polite", f"uav {i}"], forker="forker") for i in range(3)]
    assert {hear_any(supervisor) for _ in pids} == {"uav 0", "uav 1", "uav 2"}
    began_s = time.monotonic()
    supervisor.kill("uav 1")
    assert time.monotonic() - began_s < 1.0
    assert [psutil.pid_exists(pid) for pid in pids] == [True, False, True]
    exited = hear(supervisor, Exited, "uav 1")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 1 (pid {pids[1]}) was killed by SIGKILL"
    # theirs are the last ends of their pipes: no sister that was forked meanwhile holds them open
    assert supervisor.end(["uav 0", "uav 2"]) == []


def test_who_ends_at_once_does_not_hold_up_those_that_are_still_forked(supervisor: Supervisor) -> None:
    began_s = time.monotonic()
    names = [f"uav {i}" for i in range(40)]
    for i, name in enumerate(names):
        supervisor.fork(name, ["returns", str(i % 2)], forker="forker")
    heard = [supervisor.hear(WALL_LIMIT_S) for _ in names]
    assert time.monotonic() - began_s < WALL_LIMIT_S
    ends = {
        message[0]: message[1].returncode for message in heard if message and isinstance(message[1], Exited)
    }
    assert ends == {name: i % 2 for i, name in enumerate(names)}


def test_all_end_when_they_are_stopped_together_and_who_does_not_is_forced(supervisor: Supervisor) -> None:
    supervisor.fork("uav 0", ["polite", "uav 0"], forker="forker")
    pid = supervisor.fork("uav 1", ["stubborn", "uav 1"], forker="forker")
    assert {hear_any(supervisor), hear_any(supervisor)} == {"uav 0", "uav 1"}
    forced = supervisor.stop()
    # the forker waits for its own, who else would know how they ended
    forker = f"forker (pid {supervisor.pids['forker']})"
    assert forced[:3] == [
        f"{forker} did not end in time: SIGTERM",
        f"uav 1 (pid {pid}) did not end in time: SIGTERM",
        f"uav 1 (pid {pid}) did not end in time: SIGKILL",
    ]
    assert not any(alive(pid) for pid in supervisor.pids.values())


def test_they_outlive_a_forker_that_is_killed_and_only_their_status_is_lost(supervisor: Supervisor) -> None:
    pid = supervisor.fork("uav 0", ["polite", "uav 0"], forker="forker")
    hear(supervisor, Ready, "uav 0")
    os.kill(supervisor.pids["forker"], signal.SIGKILL)
    exited = hear(supervisor, Exited, "forker")
    assert isinstance(exited, Exited)
    assert exited.returncode == -signal.SIGKILL
    assert supervisor.alive("uav 0")
    with pytest.raises(SupervisorError, match=r"^uav 1: cannot be forked by forker: "):
        supervisor.fork("uav 1", ["polite", "uav 1"], forker="forker")
    supervisor.send("uav 0", SetPid(instance=0, pid=1))
    hear(supervisor, Finished, "uav 0")
    exited = hear(supervisor, Exited, "uav 0")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 0 (pid {pid}) ended with unknown status"
    assert supervisor.stop() == []


def test_forker_that_cannot_work_and_a_fork_that_is_refused_are_a_line_each(tmp_path: Path) -> None:
    supervisor = Supervisor(tmp_path)
    try:
        pid = supervisor.start_forker("forker", [*python(FORKER), "nothing"])
        exited = hear(supervisor, Exited, "forker")
        assert exited == Exited(
            name="forker",
            pid=pid,
            returncode=1,
            log_tail="forker: there is nothing to fork",
            last_words="forker: there is nothing to fork",
        )
        supervisor.start_forker("another", [*python(FORKER), "refused"])
        for name in ("uav 0", "uav 1"):  # it goes on
            with pytest.raises(SupervisorError, match=f"^{name}: cannot be forked by another: .*unavailable"):
                supervisor.fork(name, ["polite", name], forker="another")
    finally:
        supervisor.stop()


def own_threads() -> set[int]:
    return {thread.id for thread in psutil.Process().threads()}


def test_sixty_four_need_few_descriptors_no_threads_and_little_time(supervisor: Supervisor) -> None:
    before, threads, count = psutil.Process().num_fds(), own_threads(), 64
    began_s = time.process_time()
    names = [f"uav {i}" for i in range(count)]
    pids = [supervisor.fork(name, ["polite", name], forker="forker") for name in names]
    assert time.process_time() - began_s < 1.0
    ready = {hear_any(supervisor) for _ in names}
    assert ready == set(names)
    assert psutil.Process().num_fds() - before == 2 * count  # stdin and stdout
    assert own_threads() <= threads  # those of tests before this one may end
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert psutil.Process(supervisor.pids["forker"]).num_fds() < count + 16 < limit
    assert supervisor.end(names) == []
    assert not any(psutil.pid_exists(pid) for pid in pids)
    # and gives them back
    wait_for(lambda: psutil.Process().num_fds() <= before, "descriptors of children that have ended")


def test_who_is_stopped_goes_on_to_end_as_it_should(supervisor: Supervisor) -> None:
    """A forker that is stopped cannot tell how its own ended, and would hold up everybody's end."""
    names = ["uav 0", "uav 1", "uav 2"]
    for name in names:
        supervisor.fork(name, ["polite", name], forker="forker")
    assert {hear_any(supervisor) for _ in names} == set(names)
    os.kill(supervisor.pids["forker"], signal.SIGSTOP)
    supervisor.kill("uav 0")
    for name in ("forker", "uav 1"):
        os.kill(supervisor.pids[name], signal.SIGSTOP)
    began_s = time.monotonic()
    assert supervisor.end(["uav 1", "uav 2"], grace_s=WALL_LIMIT_S) == []
    assert supervisor.stop() == []
    assert time.monotonic() - began_s < WALL_LIMIT_S / 4
    ends = {}
    while (heard := supervisor.hear(0.0)) is not None:
        if isinstance(heard[1], Exited):
            ends[heard[0]] = heard[1].returncode
    assert ends == {"uav 0": -signal.SIGKILL, "uav 1": 0, "uav 2": 0, "forker": 0}


def test_who_is_left_by_a_forker_and_who_ended_with_it_is_told_in_any_order(supervisor: Supervisor) -> None:
    """The launcher waits for each that the forker has left, without its help."""
    names = [f"uav {i}" for i in range(8)]
    pids = [supervisor.fork(name, ["polite", name], forker="forker") for name in names]
    assert {hear_any(supervisor) for _ in names} == set(names)
    os.kill(supervisor.pids["forker"], signal.SIGSTOP)
    for pid in pids[::2]:
        os.kill(pid, signal.SIGKILL)
    os.kill(supervisor.pids["forker"], signal.SIGKILL)
    ends = {}
    while len(ends) < 1 + len(pids[::2]):
        heard = supervisor.hear(WALL_LIMIT_S)
        assert heard is not None
        if isinstance(heard[1], Exited):
            ends[heard[0]] = heard[1].returncode
    assert ends == dict.fromkeys(names[::2]) | {"forker": -signal.SIGKILL}
    assert supervisor.stop() == []


def hear_any(supervisor: Supervisor) -> str:
    heard = supervisor.hear(WALL_LIMIT_S)
    assert heard is not None
    assert isinstance(heard[1], Ready)
    return heard[0]


LAUNCHER = """
    supervisor.start_forker("forker", [sys.executable, "-c", sys.argv[2]])
    for i in range(3):
        supervisor.fork(f"uav {i}", ["polite", f"uav {i}"], forker="forker")
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_none_outlives_the_launcher(tmp_path: Path, number: signal.Signals) -> None:
    pids = launcher_and_children(LAUNCHER, FORKER, tmp_path, ends_by=number)
    assert len(pids) == 4

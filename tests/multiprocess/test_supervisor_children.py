"""Real children are heard, named when they end, and gone when their supervisor stops or dies."""

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import WALL_LIMIT_S, hear, launcher_and_children, python, wait_for

from foundation.processes.child_protocol import Finished, Ready
from harness.launch.interrupts import interruptible, interrupts_deferred
from harness.launch.resources import PortError, bind
from harness.launch.supervisor import MARK, Exited, Supervisor, SupervisorError, ending
from harness.simulator.messages import SetPid

pytestmark = pytest.mark.multiprocess

POLITE = """
    import os, queue
    from foundation.processes.child_protocol import Finished, Ready, Stop, commands, emit
    inbox = queue.SimpleQueue()
    commands(Stop, inbox)
    emit(Ready(name="uav 3", pid=os.getpid(), details={"gcs_local_udp": 18573}))
    inbox.get()
    emit(Finished(name="uav 3", details={"steps": 12}))
"""
STUBBORN = """
    import os, signal
    from foundation.processes.child_protocol import Ready, emit
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    emit(Ready(name="stubborn", pid=os.getpid()))
    while True:
        signal.pause()
"""
CRASHING = """
    import sys
    print("a printing library")
    print("uav 7: the simulator is unreachable", file=sys.stderr)
    sys.exit(3)
"""
PARENT = """
    import os, subprocess, sys
    from foundation.processes.child_protocol import Ready, emit
    child = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"], start_new_session=True)
    emit(Ready(name="parent", pid=os.getpid(), details={"grandchild": child.pid}))
    sys.stdin.read()
    os._exit(0)
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    supervisor = Supervisor(tmp_path)
    yield supervisor
    supervisor.stop()
    assert supervisor.strays() == []


def test_child_says_that_it_is_ready_stops_on_request_and_leaves_its_last_words(
    supervisor: Supervisor,
) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    ready = hear(supervisor, Ready, "uav 3")
    assert ready == Ready(name="uav 3", pid=pid, details={"gcs_local_udp": 18573})
    assert supervisor.alive("uav 3")
    assert supervisor.pids == {"uav 3": pid}
    assert supervisor.end(["uav 3"], grace_s=WALL_LIMIT_S) == []
    assert not supervisor.alive("uav 3")
    said = [supervisor.hear(0.0), supervisor.hear(0.0), supervisor.hear(0.0)]
    assert said[0] == ("uav 3", Finished(name="uav 3", details={"steps": 12}))
    assert said[1] == ("uav 3", Exited(name="uav 3", pid=pid, returncode=0, log_tail=""))
    assert said[2] is None
    assert supervisor.stop() == []


def test_end_of_input_is_enough_for_a_child_that_keeps_the_rule(supervisor: Supervisor) -> None:
    supervisor.start("uav 3", python(POLITE))
    hear(supervisor, Ready, "uav 3")
    assert supervisor.stop() == []


def test_killed_child_is_named_with_its_signal_within_a_second(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    hear(supervisor, Ready, "uav 3")
    began_s = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    exited = hear(supervisor, Exited, "uav 3")
    assert time.monotonic() - began_s < 1.0
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 3 (pid {pid}) was killed by SIGKILL"


def test_kill_returns_when_the_child_is_gone(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    hear(supervisor, Ready, "uav 3")
    supervisor.kill("uav 3")
    assert not psutil.pid_exists(pid)
    assert not supervisor.alive("uav 3")
    supervisor.send("uav 3", SetPid(instance=0, pid=1))  # nobody hears it, and that is no error


def test_crashed_child_is_reported_with_its_status_and_the_end_of_its_log(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 7", python(CRASHING))
    exited = hear(supervisor, Exited, "uav 7")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 7 (pid {pid}) ended with status 3"
    # what is no event on stdout stands in the log as well, in whatever order the two pipes were read
    assert set(exited.log_tail.splitlines()) == {"a printing library", "uav 7: the simulator is unreachable"}
    assert exited.last_words == "uav 7: the simulator is unreachable"


def test_what_a_library_prints_is_nobodys_last_word(supervisor: Supervisor) -> None:
    chatter = CRASHING.replace("sys.exit(3)", "sys.stderr.flush(); print('build time: May 4'); sys.exit(3)")
    supervisor.start("talks", python(chatter))
    exited = hear(supervisor, Exited, "talks")
    assert exited.log_tail.endswith("build time: May 4")
    assert exited.last_words == "uav 7: the simulator is unreachable"
    supervisor.start("prints", python("print('a library'); raise SystemExit(4)"))
    exited = hear(supervisor, Exited, "prints")
    assert (exited.log_tail, exited.last_words) == ("a library", "")


def test_child_that_ignores_all_but_sigkill_is_killed_and_named(supervisor: Supervisor) -> None:
    pid = supervisor.start("stubborn", python(STUBBORN))
    hear(supervisor, Ready, "stubborn")
    assert supervisor.end(["stubborn"], grace_s=0.1) == [
        f"stubborn (pid {pid}) did not stop when asked",
        f"stubborn (pid {pid}) did not end in time: SIGTERM",
        f"stubborn (pid {pid}) did not end in time: SIGKILL",
    ]
    assert not psutil.pid_exists(pid)


def test_grandchild_in_a_session_of_its_own_does_not_stay(supervisor: Supervisor) -> None:
    supervisor.start("parent", python(PARENT))
    ready = hear(supervisor, Ready, "parent")
    assert isinstance(ready, Ready)
    grandchild = psutil.Process(ready.details["grandchild"])
    # between fork and exec it has its parent's environment, which is marked as well; within exec it has none
    wait_for(lambda: grandchild.environ() != {}, "grandchild's environment")
    assert grandchild.environ()[MARK] == f"{supervisor.token}/parent"
    left = supervisor.stop()
    assert len(left) == 1
    assert f"(pid {grandchild.pid}) behind: SIGKILL" in left[0]
    wait_for(
        lambda: not grandchild.is_running() or grandchild.status() == psutil.STATUS_ZOMBIE, "grandchild's end"
    )


def test_several_children_die_each_under_its_own_name(supervisor: Supervisor) -> None:
    pids = {f"uav {i}": supervisor.start(f"uav {i}", python(STUBBORN)) for i in range(4)}
    heard = [supervisor.hear(WALL_LIMIT_S) for _ in pids]
    assert {message[0] for message in heard if message} == set(pids)
    began_s = time.monotonic()
    forced = supervisor.stop()
    # all at once: the time is that of one child's patience, not of four
    assert time.monotonic() - began_s < 1.0 + 2.0 + 5.0
    assert [line.split(" did")[0] for line in forced[:4]] == [
        f"{name} (pid {pid})" for name, pid in pids.items()
    ]
    assert not any(psutil.pid_exists(pid) for pid in pids.values())


def test_nothing_can_be_started_once_stopped(supervisor: Supervisor) -> None:
    supervisor.stop()
    with pytest.raises(SupervisorError, match="uav 0: not started"):
        supervisor.start("uav 0", python(POLITE))


def test_command_that_does_not_exist_is_one_line(supervisor: Supervisor) -> None:
    with pytest.raises(SupervisorError, match=r"^px4: cannot be started: .*No such file.*no-such-program'$"):
        supervisor.start("px4", ["no-such-program"])


def test_child_that_reads_nothing_does_not_stop_its_launcher(supervisor: Supervisor) -> None:
    supervisor.start("stubborn", python(STUBBORN))
    hear(supervisor, Ready, "stubborn")
    with pytest.raises(SupervisorError, match="takes no commands any more"):
        _flood(supervisor, "stubborn")
    supervisor.kill("stubborn")


def _flood(supervisor: Supervisor, name: str) -> None:
    for i in range(10_000):  # ten times what a pipe of 64 KiB holds
        supervisor.send(name, SetPid(instance=0, pid=10_000_000 + i))


def test_only_the_given_descriptors_are_inherited(supervisor: Supervisor) -> None:
    with bind(socket.SOCK_STREAM, "127.0.0.1", 0) as given, bind(socket.SOCK_STREAM, "127.0.0.1", 0):
        code = """
            import os, socket, sys
            from foundation.processes.child_protocol import Ready, emit
            inherited = [int(fd) for fd in os.listdir("/proc/self/fd") if int(fd) > 2]
            sockets = [fd for fd in inherited if os.path.exists(f"/proc/self/fd/{fd}")]
            port = socket.socket(fileno=int(sys.argv[1])).getsockname()[1]
            emit(Ready(name="physics", pid=os.getpid(), details={"fds": sockets, "port": port}))
        """
        supervisor.start("physics", [*python(code), str(given.fileno())], pass_fds=[given.fileno()])
        ready = hear(supervisor, Ready, "physics")
        assert isinstance(ready, Ready)
        assert ready.details == {"fds": [given.fileno()], "port": given.getsockname()[1]}


@pytest.mark.parametrize(("kind", "word"), [(socket.SOCK_STREAM, "TCP"), (socket.SOCK_DGRAM, "UDP")])
def test_port_in_use_is_named(kind: socket.SocketKind, word: str) -> None:
    with bind(kind, "127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortError, match=rf"^{word} port {port} on 127\.0\.0\.1: Address already in use$"):
            bind(kind, "127.0.0.1", port)
    bind(kind, "127.0.0.1", port).close()


def test_endings_in_words() -> None:
    assert ending(0) == "ended with status 0"
    assert ending(-signal.SIGSEGV) == "was killed by SIGSEGV"
    assert ending(-40) == "was killed by signal 40"


def test_interrupt_comes_after_what_must_not_be_cut() -> None:
    done = []

    def work() -> None:
        with interrupts_deferred():
            os.kill(os.getpid(), signal.SIGINT)
            # the handler runs between two instructions of the main thread: give it many
            done.extend(range(1_000))

    with pytest.raises(KeyboardInterrupt):
        work()
    assert len(done) == 1_000
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(("found", "interrupts"), [(signal.SIG_DFL, True), (signal.SIG_IGN, False)])
def test_closed_terminal_interrupts_unless_nohup_has_it_ignored(
    found: signal.Handlers, *, interrupts: bool
) -> None:
    before = signal.signal(signal.SIGHUP, found)
    try:
        with pytest.raises(KeyboardInterrupt) if interrupts else contextlib.nullcontext(), interruptible():
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == found
    finally:
        signal.signal(signal.SIGHUP, before)


def test_stop_is_not_cut_short_by_ctrl_c(supervisor: Supervisor) -> None:
    pid = supervisor.start("stubborn", python(STUBBORN))
    hear(supervisor, Ready, "stubborn")
    presses = [threading.Timer(delay_s, os.kill, (os.getpid(), signal.SIGINT)) for delay_s in (0.2, 0.4, 1.5)]
    for press in presses:
        press.start()
    with pytest.raises(KeyboardInterrupt):
        supervisor.stop()
    for press in presses:
        press.join()
    assert not psutil.pid_exists(pid)


LAUNCHER = """
    for i in range(3):
        supervisor.start(f"uav {i}", [sys.executable, "-c", sys.argv[2]])
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_child_outlives_its_launcher(tmp_path: Path, number: signal.Signals) -> None:
    pids = launcher_and_children(LAUNCHER, POLITE, tmp_path, ends_by=number)
    assert len(pids) == 3

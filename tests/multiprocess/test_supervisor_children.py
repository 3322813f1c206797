"""Child processes: their messages, the report of their end, and their end with the supervisor."""

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
from supervising import WALL_LIMIT_S, launcher_and_children, python, receive, wait_for

from foundation.processes.child_protocol import Finished, Ready
from harness.launch.death_report import ending
from harness.launch.interrupts import interruptible, interrupts_deferred
from harness.launch.resources import ResourceError, bind
from harness.launch.supervisor import MARK, Exited, Supervisor, SupervisorError
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


def test_child_reports_ready_stops_on_request_and_reports_finished(
    supervisor: Supervisor,
) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    ready = receive(supervisor, Ready, "uav 3")
    assert ready == Ready(name="uav 3", pid=pid, details={"gcs_local_udp": 18573})
    assert supervisor.alive("uav 3")
    assert supervisor.pids == {"uav 3": pid}
    assert supervisor.end(["uav 3"], grace_s=WALL_LIMIT_S) == []
    assert not supervisor.alive("uav 3")
    messages = [supervisor.receive(0.0), supervisor.receive(0.0), supervisor.receive(0.0)]
    assert messages[0] == ("uav 3", Finished(name="uav 3", details={"steps": 12}))
    assert messages[1] == ("uav 3", Exited(name="uav 3", pid=pid, returncode=0, log_tail=""))
    assert messages[2] is None
    assert supervisor.stop() == []


def test_child_ends_at_end_of_input(supervisor: Supervisor) -> None:
    supervisor.start("uav 3", python(POLITE))
    receive(supervisor, Ready, "uav 3")
    assert supervisor.stop() == []


def test_killed_child_is_reported_with_its_signal_within_a_second(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    receive(supervisor, Ready, "uav 3")
    began_s = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    exited = receive(supervisor, Exited, "uav 3")
    assert time.monotonic() - began_s < 1.0
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 3 (pid {pid}) was killed by SIGKILL"


def test_kill_returns_after_the_end_of_the_child(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 3", python(POLITE))
    receive(supervisor, Ready, "uav 3")
    supervisor.kill("uav 3")
    assert not psutil.pid_exists(pid)
    assert not supervisor.alive("uav 3")
    supervisor.send("uav 3", SetPid(instance=0, pid=1))  # a message without a receiver is no error


def test_crashed_child_is_reported_with_its_status_and_the_end_of_its_log(supervisor: Supervisor) -> None:
    pid = supervisor.start("uav 7", python(CRASHING))
    exited = receive(supervisor, Exited, "uav 7")
    assert isinstance(exited, Exited)
    assert exited.describe() == f"uav 7 (pid {pid}) ended with status 3"
    # output on stdout that is no event is in the log too; the order of the two pipes is undefined
    assert set(exited.log_tail.splitlines()) == {"a printing library", "uav 7: the simulator is unreachable"}
    assert exited.last_words == "uav 7: the simulator is unreachable"


def test_last_words_exclude_the_output_of_libraries(supervisor: Supervisor) -> None:
    printing = CRASHING.replace("sys.exit(3)", "sys.stderr.flush(); print('build time: May 4'); sys.exit(3)")
    supervisor.start("crashes", python(printing))
    exited = receive(supervisor, Exited, "crashes")
    assert exited.log_tail.endswith("build time: May 4")
    assert exited.last_words == "uav 7: the simulator is unreachable"
    supervisor.start("prints", python("print('a library'); raise SystemExit(4)"))
    exited = receive(supervisor, Exited, "prints")
    assert (exited.log_tail, exited.last_words) == ("a library", "")


def test_child_that_ignores_sigterm_is_killed_and_reported(supervisor: Supervisor) -> None:
    pid = supervisor.start("stubborn", python(STUBBORN))
    receive(supervisor, Ready, "stubborn")
    assert supervisor.end(["stubborn"], grace_s=0.1) == [
        f"stubborn (pid {pid}) did not stop when asked",
        f"stubborn (pid {pid}) did not end in time: SIGTERM",
        f"stubborn (pid {pid}) did not end in time: SIGKILL",
    ]
    assert not psutil.pid_exists(pid)


def test_grandchild_in_another_session_is_killed(supervisor: Supervisor) -> None:
    supervisor.start("parent", python(PARENT))
    ready = receive(supervisor, Ready, "parent")
    assert isinstance(ready, Ready)
    grandchild = psutil.Process(ready.details["grandchild"])
    # between fork and exec it has its parent's environment, which has the mark too; during exec it has none
    wait_for(lambda: grandchild.environ() != {}, "grandchild's environment")
    assert grandchild.environ()[MARK] == f"{supervisor.token}/parent"
    left = supervisor.stop()
    assert len(left) == 1
    assert f"(pid {grandchild.pid}) behind: SIGKILL" in left[0]
    wait_for(
        lambda: not grandchild.is_running() or grandchild.status() == psutil.STATUS_ZOMBIE, "grandchild's end"
    )


def test_end_of_several_children_is_reported_by_name(supervisor: Supervisor) -> None:
    pids = {f"uav {i}": supervisor.start(f"uav {i}", python(STUBBORN)) for i in range(4)}
    messages = [supervisor.receive(WALL_LIMIT_S) for _ in pids]
    assert {message[0] for message in messages if message} == set(pids)
    began_s = time.monotonic()
    forced = supervisor.stop()
    # in parallel: the time limits of one child, not of four
    assert time.monotonic() - began_s < 1.0 + 2.0 + 5.0
    assert [line.split(" did")[0] for line in forced[:4]] == [
        f"{name} (pid {pid})" for name, pid in pids.items()
    ]
    assert not any(psutil.pid_exists(pid) for pid in pids.values())


def test_start_after_stop_is_refused(supervisor: Supervisor) -> None:
    supervisor.stop()
    with pytest.raises(SupervisorError, match="uav 0: not started"):
        supervisor.start("uav 0", python(POLITE))


def test_unknown_command_is_one_line(supervisor: Supervisor) -> None:
    with pytest.raises(SupervisorError, match=r"^px4: cannot be started: .*No such file.*no-such-program'$"):
        supervisor.start("px4", ["no-such-program"])


def test_child_that_does_not_read_does_not_block_its_launcher(supervisor: Supervisor) -> None:
    supervisor.start("stubborn", python(STUBBORN))
    receive(supervisor, Ready, "stubborn")
    with pytest.raises(SupervisorError, match="takes no commands any more"):
        _flood(supervisor, "stubborn")
    supervisor.kill("stubborn")


def _flood(supervisor: Supervisor, name: str) -> None:
    for i in range(10_000):  # ten times the capacity of a pipe of 64 KiB
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
        ready = receive(supervisor, Ready, "physics")
        assert isinstance(ready, Ready)
        assert ready.details == {"fds": [given.fileno()], "port": given.getsockname()[1]}


@pytest.mark.parametrize(("kind", "word"), [(socket.SOCK_STREAM, "TCP"), (socket.SOCK_DGRAM, "UDP")])
def test_port_in_use_is_reported(kind: socket.SocketKind, word: str) -> None:
    with bind(kind, "127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            ResourceError, match=rf"^{word} port {port} on 127\.0\.0\.1: Address already in use$"
        ):
            bind(kind, "127.0.0.1", port)
    bind(kind, "127.0.0.1", port).close()


def test_ending_describes_a_return_code() -> None:
    assert ending(0) == "ended with status 0"
    assert ending(-signal.SIGSEGV) == "was killed by SIGSEGV (segmentation fault)"
    assert ending(-signal.SIGKILL) == "was killed by SIGKILL"
    assert ending(-40) == "was killed by signal 40"


def test_interrupt_is_deferred_to_the_end_of_the_block() -> None:
    done = []

    def work() -> None:
        with interrupts_deferred():
            os.kill(os.getpid(), signal.SIGINT)
            # the handler runs between two instructions of the main thread: run many
            done.extend(range(1_000))

    with pytest.raises(KeyboardInterrupt):
        work()
    assert len(done) == 1_000
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(("found", "interrupts"), [(signal.SIG_DFL, True), (signal.SIG_IGN, False)])
def test_sighup_interrupts_unless_it_is_ignored(found: signal.Handlers, *, interrupts: bool) -> None:
    before = signal.signal(signal.SIGHUP, found)
    try:
        with pytest.raises(KeyboardInterrupt) if interrupts else contextlib.nullcontext(), interruptible():
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == found
    finally:
        signal.signal(signal.SIGHUP, before)


def test_stop_completes_after_ctrl_c(supervisor: Supervisor) -> None:
    pid = supervisor.start("stubborn", python(STUBBORN))
    receive(supervisor, Ready, "stubborn")
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

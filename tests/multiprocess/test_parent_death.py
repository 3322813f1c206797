"""Children end with their launcher, also while they import, are stopped, or read no input."""

import os
import subprocess
import sys
import textwrap
import threading
from collections.abc import Sequence
from pathlib import Path

import psutil
import pytest
from supervising import alive, receive, wait_for

from foundation.processes.child_protocol import Ready
from harness.launch.process_commands import bound_module
from harness.launch.spawner import spawn
from harness.launch.supervisor import Supervisor

pytestmark = pytest.mark.multiprocess

MODULES = {
    "importing": "import time; print('imports', flush=True); time.sleep(600)",
    "stopped": "import os, signal; print('stops', flush=True); os.kill(os.getpid(), signal.SIGSTOP)",
    "forking": """
        import os, signal, socket, sys, time
        from foundation.processes.child_protocol import Ready, emit
        from foundation.processes.prefork import serve

        def main(arguments):
            emit(Ready(name=arguments[0], pid=os.getpid()))
            os.kill(os.getpid(), signal.SIGSTOP)
            time.sleep(600)

        if __name__ == "__main__":
            emit(Ready(name="forking", pid=os.getpid()))
            serve(socket.socket(fileno=int(sys.argv[-1])), main)
    """,
}
LAUNCHER = """
import sys, time
from pathlib import Path
from foundation.processes.child_protocol import Ready
from harness.launch.process_commands import bound_module
from harness.launch.supervisor import Supervisor
supervisor = Supervisor(Path(sys.argv[1]))
for name in ("importing", "stopped"):
    supervisor.start(name, bound_module(name))
supervisor.start_forker("forking", bound_module("forking"))
while not isinstance(supervisor.receive(60.0)[1], Ready):
    pass
supervisor.fork("uav 0", ["uav 0"], forker="forking")
logs = [Path(sys.argv[1], f"{name}.log") for name in ("importing", "stopped")]
while not all(log.exists() and log.stat().st_size for log in logs):
    time.sleep(0.01)
while not isinstance(supervisor.receive(60.0)[1], Ready):
    pass
print(*supervisor.pids.values(), flush=True)
time.sleep(600)
"""


@pytest.fixture
def modules(tmp_path: Path) -> dict[str, str]:
    """Write the modules; returns an environment in which they can be imported."""
    folder = tmp_path / "modules"
    folder.mkdir()
    for name, code in MODULES.items():
        (folder / f"{name}.py").write_text(textwrap.dedent(code))
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return {"PYTHONPATH": path}


def stopped(pids: Sequence[int]) -> int:
    """Return how many of the processes are stopped; each of them runs, waits, or is stopped."""
    return sum(psutil.Process(pid).status() == psutil.STATUS_STOPPED for pid in pids)


def test_no_child_outlives_a_killed_launcher_whatever_it_does(
    tmp_path: Path, modules: dict[str, str]
) -> None:
    command = [sys.executable, "-c", LAUNCHER, str(tmp_path)]
    with subprocess.Popen(command, env=os.environ | modules, stdout=subprocess.PIPE) as launcher:
        try:
            assert launcher.stdout is not None
            pids = [int(pid) for pid in launcher.stdout.readline().split()]
            assert len(pids) == 4
            wait_for(lambda: stopped(pids) == 2, "two children that have stopped themselves")
        finally:
            launcher.kill()
    wait_for(lambda: not any(map(alive, pids)), "end of the children")


def test_child_whose_parent_ended_before_it_was_bound_exits() -> None:
    command = bound_module("json.tool")
    number = command.index(str(os.getpid()))
    command[number] = str(os.getppid())
    done = subprocess.run(command, input=b"{}", capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")


def test_bound_module_runs_as_by_minus_m() -> None:
    done = subprocess.run(
        bound_module("json.tool", "--compact"), input=b'{"a": 1}', capture_output=True, check=True
    )
    assert done.stdout == b'{"a":1}\n'


def test_children_outlive_the_thread_that_started_them(tmp_path: Path, modules: dict[str, str]) -> None:
    supervisor = Supervisor(tmp_path, environment=modules)

    def start() -> None:
        supervisor.start("importing", bound_module("importing"))
        supervisor.start_forker("forking", bound_module("forking"))

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    receive(supervisor, Ready, "forking")
    assert supervisor.alive("importing")
    supervisor.stop()
    assert not any(map(alive, supervisor.pids.values()))


def spawned_in_fork(command: Sequence[str]) -> int:
    """Return the status of a command that a forked process has started."""
    pid = os.fork()
    if pid == 0:
        os._exit(spawn(command).wait(30.0))
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def test_a_forked_process_spawns_by_a_thread_of_its_own() -> None:
    assert spawn([sys.executable, "-c", "raise SystemExit(3)"]).wait(30.0) == 3
    assert spawned_in_fork([sys.executable, "-c", "raise SystemExit(4)"]) == 4


def test_error_of_a_command_is_that_of_popen() -> None:
    with pytest.raises(FileNotFoundError, match="no-such-program"):
        spawn(["no-such-program"])

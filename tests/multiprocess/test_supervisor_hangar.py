"""The real hangar: warm before it says so, without a thread, and its vehicles fail under their own names."""

from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import hear, python

from foundation.processes.child_protocol import Ready
from harness.launch import kernel_cache
from harness.launch.processes import HANGAR, python_module
from harness.launch.supervisor import Exited, Supervisor

pytestmark = pytest.mark.multiprocess

FAILING = """
    import sys
    from autopilot.process import prefork_server
    from autopilot.process.warm_up import RehearsalError

    def rehearse():
        raise RehearsalError("the vehicles of the rehearsal did not get on their way")

    prefork_server.rehearse = rehearse
    sys.exit(prefork_server.main())
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    supervisor = Supervisor(tmp_path, environment=kernel_cache.environment() | {"OPENBLAS_NUM_THREADS": "1"})
    yield supervisor
    assert supervisor.stop() == []
    assert supervisor.strays() == []


def test_it_runs_no_thread_which_a_fork_would_leave_behind(supervisor: Supervisor) -> None:
    pid = supervisor.start_forker(HANGAR, python_module("autopilot.process.prefork_server", "--supervised"))
    hear(supervisor, Ready, HANGAR)
    hangar = psutil.Process(pid)
    assert hangar.num_threads() == 1
    assert hangar.name() == HANGAR


def test_a_vehicle_without_settings_says_so_and_the_next_one_too(supervisor: Supervisor) -> None:
    supervisor.start_forker(HANGAR, python_module("autopilot.process.prefork_server", "--supervised"))
    hear(supervisor, Ready, HANGAR)
    for name in ("uav 0", "uav 1"):
        supervisor.fork(name, ["--config", f"no {name}.json", "--supervised"], forker=HANGAR)
        exited = hear(supervisor, Exited, name)
        assert isinstance(exited, Exited)
        assert exited.returncode == 2
        assert exited.log_tail == f"uav: [Errno 2] No such file or directory: 'no {name}.json'"
    supervisor.fork("uav 2", ["--instance", "what"], forker=HANGAR)
    exited = hear(supervisor, Exited, "uav 2")
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert "invalid int value: 'what'" in exited.log_tail


def test_a_rehearsal_that_fails_is_one_line(supervisor: Supervisor) -> None:
    supervisor.start_forker(HANGAR, python(FAILING))
    exited = hear(supervisor, Exited, HANGAR)
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert exited.log_tail == "hangar: the vehicles of the rehearsal did not get on their way"

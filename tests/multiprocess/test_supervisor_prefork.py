"""The prefork server: ready only when warm, without threads; its vehicles fail under their own names."""

from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import hear, python

from foundation.processes.child_protocol import Ready
from harness.launch import kernel_cache
from harness.launch.processes import PREFORK, python_module
from harness.launch.supervisor import Exited, Supervisor

pytestmark = pytest.mark.multiprocess

FAILING = """
    import sys
    from autopilot.process import prefork_server
    from foundation.kernels.warm_up import WarmUpError

    def warm_up():
        raise WarmUpError("the vehicles of the warm-up did not reach phase JOINING")

    prefork_server.warm_up = warm_up
    sys.exit(prefork_server.main())
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    supervisor = Supervisor(tmp_path, environment=kernel_cache.environment() | {"OPENBLAS_NUM_THREADS": "1"})
    yield supervisor
    assert supervisor.stop() == []
    assert supervisor.strays() == []


def test_it_runs_no_thread_which_a_fork_would_leave_behind(supervisor: Supervisor) -> None:
    pid = supervisor.start_forker(PREFORK, python_module("autopilot.process.prefork_server", "--supervised"))
    hear(supervisor, Ready, PREFORK)
    server = psutil.Process(pid)
    assert server.num_threads() == 1
    assert server.name() == PREFORK


def test_a_vehicle_without_settings_says_so_and_the_next_one_too(supervisor: Supervisor) -> None:
    supervisor.start_forker(PREFORK, python_module("autopilot.process.prefork_server", "--supervised"))
    hear(supervisor, Ready, PREFORK)
    for name in ("uav 0", "uav 1"):
        supervisor.fork(name, ["--config", f"no {name}.json", "--supervised"], forker=PREFORK)
        exited = hear(supervisor, Exited, name)
        assert isinstance(exited, Exited)
        assert exited.returncode == 2
        assert exited.log_tail == f"uav: [Errno 2] No such file or directory: 'no {name}.json'"
    supervisor.fork("uav 2", ["--instance", "what"], forker=PREFORK)
    exited = hear(supervisor, Exited, "uav 2")
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert "invalid int value: 'what'" in exited.log_tail


def test_a_rehearsal_that_fails_is_one_line(supervisor: Supervisor) -> None:
    supervisor.start_forker(PREFORK, python(FAILING))
    exited = hear(supervisor, Exited, PREFORK)
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert exited.log_tail == "prefork: the vehicles of the warm-up did not reach phase JOINING"

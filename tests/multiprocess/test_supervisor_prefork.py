"""The prefork server: no threads when ready, errors of its vehicles and of its warm-up."""

from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from supervising import python, receive

from foundation.processes.child_protocol import Ready
from harness.launch import kernel_cache
from harness.launch.process_commands import PREFORK, python_module
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


def test_server_has_one_thread(supervisor: Supervisor) -> None:
    pid = supervisor.start_forker(PREFORK, python_module("autopilot.process.prefork_server", "--supervised"))
    receive(supervisor, Ready, PREFORK)
    server = psutil.Process(pid)
    assert server.num_threads() == 1
    assert server.name() == PREFORK


def test_vehicles_without_settings_report_it(supervisor: Supervisor) -> None:
    supervisor.start_forker(PREFORK, python_module("autopilot.process.prefork_server", "--supervised"))
    receive(supervisor, Ready, PREFORK)
    for name in ("uav 0", "uav 1"):
        supervisor.fork(name, ["--config", f"no {name}.json", "--supervised"], forker=PREFORK)
        exited = receive(supervisor, Exited, name)
        assert isinstance(exited, Exited)
        assert exited.returncode == 2
        assert exited.log_tail == f"uav: [Errno 2] No such file or directory: 'no {name}.json'"
    supervisor.fork("uav 2", ["--instance", "what"], forker=PREFORK)
    exited = receive(supervisor, Exited, "uav 2")
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert "invalid int value: 'what'" in exited.log_tail


def test_failed_warm_up_is_one_line(supervisor: Supervisor) -> None:
    supervisor.start_forker(PREFORK, python(FAILING))
    exited = receive(supervisor, Exited, PREFORK)
    assert isinstance(exited, Exited)
    assert exited.returncode == 2
    assert exited.log_tail == "prefork: the vehicles of the warm-up did not reach phase JOINING"

"""Processes, namespaces and interfaces end with whatever is killed; other processes can enter a vehicle."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import psutil
import pytest
from supervising import alive, wait_for
from vehicle_programs import (  # noqa: F401  a fixture
    Channel,
    HostProcess,
    as_other,
    namespaces,
    needs,
    network_config,
    programs_on_vehicles,
    python_of_others,
)

from foundation.processes.child_protocol import Ready

pytestmark = [pytest.mark.multiprocess, pytest.mark.usefixtures("namespaces")]

LIMIT_S = 2.0
"""Wall time within which nothing is left after a kill."""
DAEMON = "setsid sh -c 'trap \"\" TERM HUP; while true; do sleep 1; done' & echo started; sleep 1000"
"""A program whose child has a session of its own and ignores signals."""
LAUNCHER = """
import sys
from pathlib import Path
from foundation.processes.child_protocol import Ready
from harness.launch.process_commands import bound_module
from harness.launch.supervisor import Supervisor
supervisor = Supervisor(Path(sys.argv[1]))
supervisor.start("network", bound_module("netsim.network", "--config", sys.argv[2], "--supervised"))
while not isinstance(message := supervisor.receive(20.0)[1], Ready):
    pass
holders = message.details["holders"].values()
print(message.pid == supervisor.pids["network"], message.pid, *holders, flush=True)
if sys.stdin.read(1):
    supervisor.stop()
"""
ENTER = """
import sys
from netsim.network.vehicle_entry import enter_vehicle
sys.exit(enter_vehicle(int(sys.argv[1]), sys.argv[2:]))
"""


def inodes(pids):
    """Return the network namespaces of processes, without that of this process."""
    found = set()
    for pid in pids:
        with contextlib.suppress(OSError):
            found.add(Path(f"/proc/{pid}/ns/net").readlink())
    return found - {Path("/proc/self/ns/net").readlink()}


def processes_in(namespaces_of_run):
    """Return the processes of the machine that are in these network namespaces."""
    return [pid for pid in psutil.pids() if inodes([pid]) & namespaces_of_run]


@contextlib.contextmanager
def run(*, other_user=False):
    """Yield a host process with a daemon on each vehicle, its processes and its vehicles' namespaces."""
    programs = [(station, ["sh", "-c", DAEMON]) for station in (0, 1)]
    with programs_on_vehicles(programs, stations=(0, 1), other_user=other_user) as (_, host):
        host.start()
        for index in range(2):
            host.wait_for_log(index, "started")
        parent = psutil.Process(host.process.pid)
        pids = [each.pid for each in parent.children(recursive=True)]
        holders = [int(pid) for pid in host.ready.details["holders"].values()]
        assert set(holders) < set(pids)
        vehicles = inodes(holders)
        assert len(vehicles) == 2
        assert len(processes_in(vehicles)) >= 2 * 4  # holder, shell, two of its children
        yield host, pids, vehicles


def assert_nothing_is_left(pids, vehicles, since_s):
    wait_for(lambda: not any(map(alive, pids)) and not processes_in(vehicles), "end of all processes")
    assert time.monotonic() - since_s < LIMIT_S


@needs("setpriv", "setsid")
@pytest.mark.parametrize("other_user", [False, True], ids=["own user", "other user"])
@pytest.mark.parametrize(
    ("victim", "number"),
    [("parent", signal.SIGKILL), ("parent", signal.SIGTERM), ("first process", signal.SIGKILL)],
)
def test_nothing_outlives_a_killed_process(victim, number, other_user):
    with run(other_user=other_user) as (host, pids, vehicles):
        parent = psutil.Process(host.process.pid)
        (first,) = parent.children()
        begin_s = time.monotonic()
        (parent if victim == "parent" else first).send_signal(number)
        host.process.wait(10.0)
        assert_nothing_is_left(pids, vehicles, begin_s)


@needs("setsid")
def test_nothing_outlives_the_end_of_the_input():
    with run() as (host, pids, vehicles):
        begin_s = time.monotonic()
        host.process.stdin.close()
        assert host.process.wait(10.0) == 0
        assert_nothing_is_left(pids, vehicles, begin_s)


@needs("setsid")
def test_nothing_outlives_a_stop():
    with run() as (host, pids, vehicles):
        host.stop()
        assert_nothing_is_left(pids, vehicles, time.monotonic())


def test_nothing_outlives_a_launcher_that_is_killed_while_networks_are_made():
    launcher = (sys.executable, "-c", "import subprocess, sys; subprocess.run(sys.argv[1:])")
    with contextlib.closing(Channel((0, 1, 2, 3))) as channel:
        for wall_s in (0.1, 0.3, 0.5, 0.8, 1.2):
            with contextlib.closing(HostProcess(channel, [], before=launcher)) as host:
                parent = psutil.Process(host.process.pid)
                time.sleep(wall_s)  # a different place of its start each time
                pids = [each.pid for each in parent.children(recursive=True)]
                vehicles = inodes(pids)
                host.process.send_signal(signal.SIGKILL)
                host.process.wait(10.0)
                if len(pids) > 1:  # it has bound itself to its parent
                    assert_nothing_is_left(pids, vehicles, time.monotonic())


@pytest.mark.parametrize("is_killed", [True, False], ids=["killed", "stopping"])
def test_nothing_outlives_its_supervisor(tmp_path, is_killed):
    path = tmp_path / "network.json"
    with contextlib.closing(Channel((0, 1))) as channel:
        path.write_bytes(msgspec.json.encode(network_config(channel, ())))
        launcher = subprocess.Popen(
            [sys.executable, "-c", LAUNCHER, tmp_path, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        with launcher:
            same, *numbers = launcher.stdout.readline().split()
            assert same == b"True"
            pid, *holders = map(int, numbers)
            pids = [pid, *(each.pid for each in psutil.Process(pid).children(recursive=True))]
            assert set(holders) < set(pids)
            vehicles = inodes(holders)
            begin_s = time.monotonic()
            if is_killed:
                launcher.kill()
            else:
                launcher.communicate(b"stop", timeout=20.0)
                assert launcher.returncode == 0
        assert_nothing_is_left(pids, vehicles, begin_s)


@needs("setpriv")
@pytest.mark.parametrize("other_user", [False, True], ids=["own user", "other user"])
def test_command_enters_a_vehicle_by_its_holder(other_user):
    with programs_on_vehicles([], other_user=other_user) as (_, host):
        holder = str(host.ready.details["holders"]["3"])
        python, environment = python_of_others() if other_user else (sys.executable, None)
        code = "import os, socket; socket.socket().bind(('10.1.0.3', 0)); print(os.getuid())"
        enter = [*(as_other() if other_user else ()), python, "-c", ENTER, holder]
        done = subprocess.run(
            [*enter, python, "-c", code], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout == "0\n"  # root of its user namespace
        statuses = [
            subprocess.run([*enter, *command], env=environment, capture_output=True, check=False).returncode
            for command in (["sh", "-c", "exit 5"], ["/no/such/program"], ["sh", "-c", "kill -9 $$"])
        ]
        assert statuses == [5, 127, 128 + 9]
        host.stop()


def test_holder_of_another_user_cannot_be_entered():
    python, environment = python_of_others()
    with programs_on_vehicles([]) as (_, host):
        command = [*as_other(), python, "-c", ENTER, str(host.ready.details["holders"]["3"]), "true"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "PermissionError" in done.stderr


def test_ready_names_the_process_that_was_started():
    with programs_on_vehicles([]) as (_, host):
        assert isinstance(host.ready, Ready)
        assert host.ready.pid == host.process.pid
        assert os.getpid() == psutil.Process(host.ready.pid).ppid()

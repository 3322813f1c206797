"""What is reported where the system permits no namespaces, by limits of a user namespace of its own."""

import shutil
import subprocess
import sys

import pytest
from vehicle_programs import namespaces, needs  # noqa: F401  a fixture

from netsim.network.namespaces import why_not

pytestmark = [pytest.mark.multiprocess, pytest.mark.usefixtures("namespaces")]

REASON = "from netsim.network.namespaces import why_not; print(why_not())"


def limited(kind):
    """Return the beginning of a command that may make no further namespaces of a kind."""
    script = f'echo 0 > /proc/sys/user/max_{kind}_namespaces && exec "$@"'
    return ["unshare", "--user", "--map-root-user", "sh", "-c", script, "sh"]


@needs("unshare")
@pytest.mark.parametrize("kind", ["user", "net", "pid"])
def test_limit_is_named_with_its_remedy(kind):
    command = [*limited(kind), sys.executable, "-c", REASON]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode and "max_" in done.stderr:
        pytest.skip("limits of namespaces cannot be set here")
    (line,) = done.stdout.splitlines()
    assert line.startswith("no ")
    # a limit of network namespaces is of the outer user namespace, and not readable in the inner one
    assert f"user.max_{kind}_namespaces{'' if kind == 'net' else ' is 0: sudo sysctl'}" in line


@needs("unshare")
@pytest.mark.parametrize("kind", ["user", "net"])
def test_process_ends_with_this_line(kind, tmp_path):
    path = tmp_path / "network.json"
    path.write_text(
        '{"run_id": "r", "endpoint": "tcp/127.0.0.1:1", "user": "u", "password": "p", "stations": [0]}'
    )
    command = [*limited(kind), sys.executable, "-m", "netsim.network", "--config", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("network: no ")
    assert f"user.max_{kind}_namespaces" in line


def test_invalid_settings_are_one_line(tmp_path):
    path = tmp_path / "network.json"
    path.write_text('{"run_id": "r", "stations": []}')
    command = [sys.executable, "-m", "netsim.network", "--config", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("network: ")
    assert len(done.stderr.splitlines()) == 1


def test_attempt_leaves_this_process_as_it_is():
    before = subprocess.check_output([shutil.which("readlink"), "/proc/self/ns/user", "/proc/self/ns/net"])
    assert why_not() is None
    after = subprocess.check_output([shutil.which("readlink"), "/proc/self/ns/user", "/proc/self/ns/net"])
    assert before == after

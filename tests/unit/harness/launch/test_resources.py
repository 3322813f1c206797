"""Resources of a run are acquired before it starts, or named in a one-line error."""

import resource
import subprocess
import sys

import pytest

from harness.launch.process_commands import PHYSICS, PREFORK, RADIO
from harness.launch.resources import (
    DESCRIPTORS_BESIDE,
    DESCRIPTORS_OF_CHILD,
    allow_descriptors,
    open_descriptors,
)

CHILDREN = 64 + len((PHYSICS, RADIO, PREFORK))
NARROW = """
import resource, subprocess, sys
resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))
from harness.launch.resources import ResourceError, allow_descriptors
try:
    allow_descriptors({children})
except ResourceError as error:
    sys.exit(str(error))
code = "import resource; print(*resource.getrlimit(resource.RLIMIT_NOFILE))"
subprocess.run([sys.executable, "-c", code], check=True)
"""


def limits_of_a_child(soft: int, hard: int) -> "subprocess.CompletedProcess[str]":
    """Return the limits of a child whose launcher began with these, in a process of its own."""
    code = NARROW.format(soft=soft, hard=hard, children=CHILDREN)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_limit_is_raised_as_far_as_needed_and_children_inherit_it() -> None:
    done = limits_of_a_child(soft=100, hard=5_000)
    assert done.returncode == 0, done.stderr
    soft, hard = map(int, done.stdout.split())
    needed = DESCRIPTORS_BESIDE + DESCRIPTORS_OF_CHILD * CHILDREN
    assert needed < soft < needed + 50  # an interpreter has few files open
    assert hard == 5_000


def test_a_limit_that_is_high_enough_stays() -> None:
    assert limits_of_a_child(soft=4_000, hard=5_000).stdout.split() == ["4000", "5000"]
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    allow_descriptors(0)
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == before


def test_a_limit_of_the_system_is_an_error_in_one_line() -> None:
    done = limits_of_a_child(soft=100, hard=200)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"{CHILDREN} processes take ")
    assert done.stderr.endswith("file descriptors, and the limit is 200 (ulimit -Hn)\n")


def test_open_descriptors_are_counted() -> None:
    before = open_descriptors()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert open_descriptors() == before + 1
        child.kill()
    assert open_descriptors() == before


@pytest.mark.parametrize("soft", [40, 64])
def test_an_exhausted_limit_is_the_same_error(soft: int) -> None:
    assert limits_of_a_child(soft=soft, hard=soft).stderr.endswith(f"the limit is {soft} (ulimit -Hn)\n")

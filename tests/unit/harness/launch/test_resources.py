"""What a run needs of its machine is had before it starts, or named in a line."""

import resource
import subprocess
import sys

import pytest

from harness.launch.processes import PHYSICS, PREFORK, RADIO
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
    """Limits that a child of a launcher has which began with these; a limit once lowered stays so."""
    code = NARROW.format(soft=soft, hard=hard, children=CHILDREN)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_limit_is_raised_as_far_as_needed_and_children_inherit_it() -> None:
    told = limits_of_a_child(soft=100, hard=5_000)
    assert told.returncode == 0, told.stderr
    soft, hard = map(int, told.stdout.split())
    needed = DESCRIPTORS_BESIDE + DESCRIPTORS_OF_CHILD * CHILDREN
    assert needed < soft < needed + 50  # an interpreter has few files open
    assert hard == 5_000


def test_a_limit_that_is_high_enough_stays() -> None:
    assert limits_of_a_child(soft=4_000, hard=5_000).stdout.split() == ["4000", "5000"]
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    allow_descriptors(0)
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == before


def test_what_the_system_does_not_allow_is_one_line() -> None:
    told = limits_of_a_child(soft=100, hard=200)
    assert told.returncode == 1
    assert told.stderr.count("\n") == 1
    assert told.stderr.startswith(f"{CHILDREN} processes take ")
    assert told.stderr.endswith("file descriptors, and the limit is 200 (ulimit -Hn)\n")


def test_open_descriptors_are_counted() -> None:
    before = open_descriptors()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert open_descriptors() == before + 1
        child.kill()
    assert open_descriptors() == before


@pytest.mark.parametrize("soft", [40, 64])
def test_a_limit_that_is_used_up_is_no_other_error(soft: int) -> None:
    assert limits_of_a_child(soft=soft, hard=soft).stderr.endswith(f"the limit is {soft} (ulimit -Hn)\n")

"""Started processes have the scheduling of the caller's thread."""

import os
import subprocess
import sys
import threading

import pytest

from harness.launch.spawner import spawn

REPORT = "import os; print(sorted(os.sched_getaffinity(0)), os.getpriority(os.PRIO_PROCESS, 0))"


def reported() -> str:
    with spawn([sys.executable, "-c", REPORT], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        return process.stdout.read().decode().strip()


def present() -> str:
    return f"{sorted(os.sched_getaffinity(0))} {os.getpriority(os.PRIO_PROCESS, 0)}"


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor")
def test_children_have_processors_and_niceness_of_the_caller() -> None:
    found = []

    def change() -> None:  # of this thread alone
        for processor in sorted(os.sched_getaffinity(0)):
            os.sched_setaffinity(0, [processor])
            found.append((reported(), present()))
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, 0) + 1)
        found.append((reported(), present()))

    before = present()
    assert reported() == before
    thread = threading.Thread(target=change)
    thread.start()
    thread.join()
    assert len(found) > 2
    assert all(child == caller for child, caller in found)
    assert reported() == present() == before


def test_errors_are_raised_in_the_caller() -> None:
    with pytest.raises(FileNotFoundError):
        spawn(["/nonexistent/program"])

"""The scheduling policy of processes that a simulator serves."""

import errno
import os
import subprocess
import sys

import pytest

from foundation.processes.scheduling import yield_when_woken

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the policy")


def test_a_sandbox_that_forbids_the_policy_is_no_error(monkeypatch):
    calls = []

    def refuse(pid, policy, param):
        calls.append((pid, policy, param.sched_priority))
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    yield_when_woken()
    assert calls == [(0, os.SCHED_BATCH, 0)]


def test_a_program_that_is_started_afterwards_has_the_policy():
    code = "import os; print(os.sched_getscheduler(0))"
    starts = f"yield_when_woken(); sys.exit(subprocess.call([sys.executable, '-c', {code!r}]))"
    imports = "import subprocess, sys; from foundation.processes.scheduling import yield_when_woken"
    assert int(subprocess.check_output([sys.executable, "-c", f"{imports}; {starts}"])) == os.SCHED_BATCH

"""Reasons why a system permits no namespaces: one line each, with the remedy."""

import errno
import os

import pytest

from netsim.network.namespace_errors import USER, explained

CLONE = "/proc/sys/kernel/unprivileged_userns_clone"
LIMIT = "/proc/sys/user/max_user_namespaces"
APPARMOR = "/proc/sys/kernel/apparmor_restrict_unprivileged_userns"
FILTERED = "Name:\tpython\nSeccomp:\t2\nSeccomp_filters:\t1"


@pytest.mark.parametrize(
    ("files", "number", "remedy"),
    [
        ({CLONE: "0", APPARMOR: "1"}, errno.EPERM, "sudo sysctl kernel.unprivileged_userns_clone=1"),
        ({LIMIT: "0"}, errno.ENOSPC, "sudo sysctl user.max_user_namespaces="),
        ({LIMIT: "9", CLONE: "1"}, errno.ENOSPC, "a limit is reached"),
        ({}, errno.EINVAL, "CONFIG_USER_NS"),
        (
            {APPARMOR: "1", "/proc/self/status": FILTERED},
            errno.EPERM,
            "restrict_unprivileged_userns=0",
        ),
        ({APPARMOR: "0", "/proc/self/status": FILTERED}, errno.EPERM, "--security-opt seccomp=unconfined"),
        ({"/proc/self/status": "Seccomp:\t0"}, errno.EPERM, "chroot"),
    ],
)
def test_reason_names_the_remedy(files, number, remedy):
    error = explained(OSError(number, os.strerror(number)), USER, files.get)
    assert remedy in str(error)
    cause = "a limit is reached" if number == errno.ENOSPC else os.strerror(number)
    assert str(error).startswith(f"no {USER} for the vehicles' programs: {cause}; ")
    assert "\n" not in str(error)


def test_own_system_is_read():
    assert "user namespace" in str(explained(OSError(errno.EPERM, "x"), USER))

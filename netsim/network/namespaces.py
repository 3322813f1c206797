"""Linux namespaces for the programs of vehicles, without privileges: user, PID, mount and network.

`run_as_first_process` makes the calling process the parent of PID 1 of a PID namespace: the kernel ends all
processes of the namespace with PID 1, and PID 1 with its parent, whatever kills it. The user namespace gives
the capabilities to configure network namespaces of its own, but none over the host's network, to which PID 1
still belongs, so that it can reach the emulator. This holds for root too.

Sources: user_namespaces(7), pid_namespaces(7), network_namespaces(7), prctl(2). Python 3.11 has neither
`os.unshare` nor `os.setns`.
"""

import ctypes
import os
import select
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from foundation.processes.parent_death import end_with_parent_process
from netsim.network.namespace_errors import NETWORK, PIPE, USER, NamespaceError, explained

CLONE_NEWNS, CLONE_NEWUSER, CLONE_NEWPID, CLONE_NEWNET = 0x00020000, 0x10000000, 0x20000000, 0x40000000
"""linux/sched.h: mount, user, PID and network namespaces."""
MS_RDONLY, MS_NOSUID, MS_NODEV, MS_NOEXEC, MS_REMOUNT, MS_BIND, MS_REC = 1, 2, 4, 8, 0x20, 0x1000, 0x4000
"""linux/mount.h, flags of `mount`."""
_MS_PRIVATE = 0x40000
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def unshare(flags: int) -> None:
    """Put this thread into new namespaces; a PID namespace holds its later children only. Raises OSError."""
    _call("unshare", flags)


def set_namespace(fd: int, kind: int = 0) -> None:
    """Put this thread into the namespace of an open file; ``kind`` 0: any. Raises OSError."""
    _call("setns", fd, kind)


def own_network_namespace() -> int:
    """Return a file descriptor of this thread's network namespace, which exists as long as it is open."""
    return _own_namespace("net")


def own_mount_namespace() -> int:
    """Return a file descriptor of this thread's mount namespace, which exists as long as it is open."""
    return _own_namespace("mnt")


def mount(source: str, target: str, kind: str, flags: int) -> None:
    """Mount a file system of a kind, or, with MS_BIND, a file or folder. Raises OSError."""
    _call("mount", *(each.encode() for each in (source, target, kind)), flags, None)


def unmount(target: str) -> None:
    """Unmount the last mount at a place. Raises OSError."""
    _call("umount2", target.encode(), 0)


def new_network_namespace() -> int:
    """Put this thread into a new network namespace and return its descriptor. Raises NamespaceError."""
    try:
        unshare(CLONE_NEWNET)
        return own_network_namespace()
    except OSError as error:
        raise explained(error, NETWORK) from None


def run_as_first_process(main: Callable[[int], int]) -> int:
    """Run ``main`` in PID 1 of new user, mount and PID namespaces, and return its status in both processes.

    ``main`` is called with a descriptor of the host's ``/proc``. To be called with one thread. The kernel
    ends PID 1 with this process, and this process with its parent. Raises NamespaceError.
    """
    parent, outer_proc = os.getppid(), os.open("/proc", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    _enter_user_namespace()
    end_with_parent_process(parent)  # after it: the kernel clears the setting when capabilities change
    alive, end = os.pipe()
    try:
        pid = os.fork()
    except OSError as error:
        raise explained(error, PIPE) from None
    if pid == 0:
        os.close(end)
        _end_with(alive)
        _mount_own_proc()
        return main(outer_proc)
    os.close(alive)
    os.close(outer_proc)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # PID 1 ends by a command
    return _status_of(pid)


def _status_of(pid: int) -> int:
    """Return the exit status of PID 1, or end by the signal that killed it; stop when it is stopped.

    So a supervisor that looks at this process sees the state of PID 1.
    """
    while True:
        status = os.waitpid(pid, os.WUNTRACED)[1]
        if os.WIFSTOPPED(status):
            os.kill(os.getpid(), signal.SIGSTOP)
            os.kill(pid, signal.SIGCONT)
        elif os.WIFSIGNALED(status):
            number = os.WTERMSIG(status)
            if number != signal.SIGKILL:
                signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        else:
            return os.waitstatus_to_exitcode(status)


def outer_pid(outer_proc: int) -> int:
    """Return the id of this process in the PID namespace of an open ``/proc``."""
    return int(os.readlink("self", dir_fd=outer_proc))


def why_not() -> str | None:
    """Return why this system does not permit the namespaces, as one line; None if it does.

    Makes them in a child process, which ends at once.
    """
    if sys.platform != "linux":
        return "network namespaces are of Linux"
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(reader)
        _try_namespaces(writer)
    os.close(writer)
    with os.fdopen(reader, encoding="utf-8") as answer:
        reason = answer.read()
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return reason or (None if status == 0 else f"the attempt to make namespaces ended with status {status}")


def _try_namespaces(writer: int) -> NoReturn:
    """Make the namespaces, write why it is impossible, and exit; must not return into the parent's code."""
    status = 1
    try:
        _enter_user_namespace()
        pid = os.fork()
        if pid == 0:
            new_network_namespace()
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    except OSError as error:
        os.write(writer, str(error).encode())
    finally:
        os._exit(status)


def _enter_user_namespace() -> None:
    """Put this process into a new user namespace as its root, and its children into a new PID namespace."""
    uid, gid = os.geteuid(), os.getegid()
    try:
        unshare(CLONE_NEWUSER | CLONE_NEWNS | CLONE_NEWPID)
        for name, text in (("setgroups", "deny"), ("uid_map", f"0 {uid} 1"), ("gid_map", f"0 {gid} 1")):
            Path("/proc/self", name).write_text(text, encoding="ascii")
    except OSError as error:
        raise explained(error, USER) from None


def _end_with(alive: int) -> None:
    """Let the kernel kill this process with its parent, which holds the other end of a pipe.

    The parent is of another PID namespace, in which `os.getppid` has no name for it.
    """
    _call("prctl", _PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    ready, _, _ = select.select([alive], [], [], 0.0)
    if ready:  # its end is closed: it ended before this call
        os._exit(1)


def _mount_own_proc() -> None:
    """Mount ``/proc`` of the own PID namespace, for ``ps``; left out where the system forbids it.

    It does so in containers that mask parts of ``/proc`` (mount_namespaces(7)).
    """
    try:
        mount("none", "/", "", MS_REC | _MS_PRIVATE)
        mount("proc", "/proc", "proc", MS_NOSUID | MS_NODEV | MS_NOEXEC)
    except OSError:
        pass


def _own_namespace(kind: str) -> int:
    return os.open(f"/proc/thread-self/ns/{kind}", os.O_RDONLY | os.O_CLOEXEC)


def _call(name: str, *arguments: object) -> None:
    """Call a function of the C library that returns 0. Raises OSError."""
    if _libc is None:
        raise NamespaceError(f"{name} is of Linux")
    function = getattr(_libc, name)
    if function(*(ctypes.c_ulong(each) if isinstance(each, int) else each for each in arguments)):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))

"""What programs of a vehicle find in ``/sys`` and ``/etc/hosts``: their own interfaces, names of vehicles.

Both are mounts in namespaces of the run; no file of the host changes. What the system forbids is left out, as
in containers that mask parts of ``/sys`` (mount_namespaces(7)).

Sources: sysfs(5), hosts(5), mount(2), user_namespaces(7).
"""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from netsim.network.namespaces import (
    CLONE_NEWNS,
    MS_BIND,
    MS_NODEV,
    MS_NOEXEC,
    MS_NOSUID,
    MS_RDONLY,
    MS_REC,
    MS_REMOUNT,
    mount,
    own_mount_namespace,
    set_namespace,
    unmount,
    unshare,
)

_HOSTS, _SYS, _CGROUPS = "/etc/hosts", "/sys", "/sys/fs/cgroup"
_RESTRICTED = MS_NOSUID | MS_NODEV | MS_NOEXEC


def add_host_names(addresses: Mapping[str, str]) -> None:
    """Let ``/etc/hosts`` have further names, with these addresses, in this process's mount namespace.

    The file is in a file system in memory, which lasts as long as it is mounted here or in copies of this
    namespace.
    """
    with contextlib.suppress(OSError):
        present = Path(_HOSTS).read_bytes()
        lines = "".join(f"{address}\t{name}\n" for name, address in addresses.items())
        mount("tmpfs", _SYS, "tmpfs", _RESTRICTED)  # any folder, for a moment
        try:
            file = Path(_SYS, "hosts")
            file.write_bytes(present.rstrip() + b"\n" + lines.encode())
            file.chmod(0o644)
            mount(str(file), _HOSTS, "", MS_BIND)
            mount("", _HOSTS, "", MS_REMOUNT | MS_BIND | MS_RDONLY | _RESTRICTED)
        finally:
            unmount(_SYS)


def new_mount_namespace(base: int) -> int:
    """Put this process into a copy of a mount namespace, with ``/sys`` of its network namespace.

    Return a descriptor, of the present mount namespace where the system forbids another.
    """
    with contextlib.suppress(OSError):
        set_namespace(base, CLONE_NEWNS)
        unshare(CLONE_NEWNS)
        _mount_sysfs()
    return own_mount_namespace()


def _mount_sysfs() -> None:
    with contextlib.ExitStack() as stack:
        cgroups = -1
        with contextlib.suppress(OSError):
            cgroups = os.open(_CGROUPS, os.O_PATH | os.O_CLOEXEC)
            stack.callback(os.close, cgroups)
        try:
            mount("sysfs", _SYS, "sysfs", _RESTRICTED)
        except OSError:  # where the host's is read-only, only such ones are permitted
            mount("sysfs", _SYS, "sysfs", _RESTRICTED | MS_RDONLY)
        # programs find their limits of memory and processors there
        mount(f"/proc/self/fd/{cgroups}", _CGROUPS, "", MS_BIND | MS_REC)

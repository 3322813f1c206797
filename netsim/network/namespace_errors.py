"""Why a system does not permit namespaces, and what to do about it, as one line; reads kernel settings.

Sources: user_namespaces(7), unshare(2); Debian's kernel.unprivileged_userns_clone; Ubuntu 24.04,
kernel.apparmor_restrict_unprivileged_userns; Docker's default seccomp profile.
"""

import errno
import re
from collections.abc import Callable
from pathlib import Path

from foundation.system_error import in_words

USER, NETWORK, PIPE = "user namespace", "network namespace", "process"
"""What could not be made."""
_FILTERED = re.compile(r"^Seccomp:\s*2$", re.MULTILINE)


class NamespaceError(OSError):
    """The system does not permit namespaces; the text is one line."""


def explained(error: OSError, what: str, read: Callable[[str], str | None] | None = None) -> NamespaceError:
    """Return the error with its probable cause and its remedy.

    ``read`` returns the stripped text of a file, None if there is none.
    """
    remedy = _remedy(error.errno, read or _read)
    cause = "a limit is reached" if error.errno == errno.ENOSPC else in_words(error)
    return NamespaceError(f"no {what} for the vehicles' programs: {cause}{remedy}")


def _remedy(number: int | None, read: Callable[[str], str | None]) -> str:
    if read("/proc/sys/kernel/unprivileged_userns_clone") == "0":
        return "; user namespaces are switched off: sudo sysctl kernel.unprivileged_userns_clone=1"
    for kind in ("user", "net", "pid", "mnt"):
        name = f"user.max_{kind}_namespaces"
        if read(f"/proc/sys/{name.replace('.', '/')}") == "0":
            return f"; {name} is 0: sudo sysctl {name}=10000"
    if number == errno.ENOSPC:
        return "; see sysctl user.max_user_namespaces and user.max_net_namespaces"
    if number in {errno.EINVAL, errno.ENOSYS}:
        return "; the kernel has no such namespaces (CONFIG_USER_NS, CONFIG_NET_NS, CONFIG_PID_NS)"
    if read("/proc/sys/kernel/apparmor_restrict_unprivileged_userns") == "1":
        return (
            "; AppArmor restricts user namespaces: sudo sysctl "
            "kernel.apparmor_restrict_unprivileged_userns=0, or an AppArmor profile with `userns,` for the "
            "Python interpreter"
        )
    if _FILTERED.search(read("/proc/self/status") or ""):
        return (
            "; a container's seccomp filter forbids it: start the container with --security-opt "
            "seccomp=unconfined, or with --cap-add SYS_ADMIN"
        )
    return "; the process may be in a chroot or under a security policy that forbids user namespaces"


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return None

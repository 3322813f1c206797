"""Whether another user of the machine can replace a folder or file, or what a folder holds."""

import grp
import os
import pwd
import stat
from pathlib import Path
from typing import NamedTuple

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class Fault(NamedTuple):
    """Why a folder or file is not trusted, and what to do."""

    reason: str
    remedy: str

    def __str__(self) -> str:
        """Return both in words."""
        return f"{self.reason}: {self.remedy}"


def fault_of(path: Path, status: os.stat_result, *, sticky_protects: bool = False) -> Fault | None:
    """Return why a folder or file is not trusted, given its status; None if it is.

    It is if it belongs to this user or root, and no other may write it. The group of this user's name without
    other members may; with ``sticky_protects`` also all users, if each may delete only their own files
    (sticky, as /tmp).
    """
    if status.st_uid not in {os.geteuid(), 0}:
        return Fault(f"{path} belongs to {_user(status.st_uid)}", "delete it")
    writers = status.st_mode & _OTHERS_WRITE
    if writers == stat.S_IWGRP and _is_own_group(status.st_gid):
        return None
    if not writers or (sticky_protects and status.st_mode & stat.S_ISVTX):
        return None
    return Fault(f"other users can write {path}", f"chmod -R go-w {path}")


def _is_own_group(group_id: int) -> bool:
    """Return whether a group is this user's alone, as on systems with a group for each user."""
    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(group_id)
    except KeyError:
        return False
    return group.gr_name == user.pw_name and user.pw_gid == group_id and {*group.gr_mem} <= {user.pw_name}


def _user(user_id: int) -> str:
    try:
        return f"the user {pwd.getpwuid(user_id).pw_name}"
    except KeyError:
        return f"the user with id {user_id}"

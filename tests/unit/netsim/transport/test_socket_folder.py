"""Folders of the radio's sockets: their places, their rights, and their removal after a kill."""

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from other_user import OTHER_UID, root_only
from paths import ROOT

from netsim.transport import socket_folder
from netsim.transport.socket_folder import KEPT_S, LOCK, LONGEST_PATH_BYTES, SocketFolder

HOLDER = """
import subprocess, sys
from netsim.transport.socket_folder import SocketFolder
folder = SocketFolder()
(folder.path / "radio").touch()
child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
print(folder.path, flush=True)
input()
"""


@pytest.fixture
def parent(monkeypatch):
    """Yield the folder for sockets of this test, whose path is shorter than those of pytest's folders."""
    with tempfile.TemporaryDirectory(dir=socket_folder._LAST_PARENT) as name:
        folder = Path(name)
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        monkeypatch.setattr("tempfile.tempdir", name)
        monkeypatch.setattr(socket_folder, "_LAST_PARENT", name)
        yield folder


def made():
    """Return the path of a folder that is removed at once, and its mode."""
    folder = SocketFolder()
    mode = stat.S_IMODE(folder.path.stat().st_mode)
    for _ in range(2):
        folder.remove()
    assert not folder.path.exists()
    return folder.path, mode


def test_a_socket_folder_is_private_and_in_the_users_folder_if_there_is_one(parent):
    path, mode = made()
    assert (path.parent, mode) == (parent, 0o700)


@pytest.mark.parametrize("name", ["x" * LONGEST_PATH_BYTES, "what?"])
def test_a_folder_in_which_no_socket_can_be_is_passed_over(parent, monkeypatch, name):
    unusable = parent / name
    unusable.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(unusable))
    monkeypatch.setattr("tempfile.tempdir", str(unusable))
    assert made()[0].parent == parent
    assert list(unusable.iterdir()) == []
    monkeypatch.setattr(socket_folder, "_LAST_PARENT", str(unusable))
    with pytest.raises(OSError, match=r"a socket's path has at most 107 bytes and no . or #; set TMPDIR to"):
        SocketFolder()


def test_a_folder_that_others_can_write_is_passed_over_unless_it_is_sticky(parent, monkeypatch):
    shared = parent / "shared"
    shared.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shared))
    shared.chmod(0o777)
    assert made()[0].parent == parent
    shared.chmod(0o1777)
    assert made()[0].parent == shared
    shared.chmod(0o777)
    monkeypatch.setattr("tempfile.tempdir", str(shared))
    monkeypatch.setattr(socket_folder, "_LAST_PARENT", str(shared))
    with pytest.raises(OSError, match=f"socket: other users can write {shared}; set TMPDIR to another one"):
        SocketFolder()


@root_only
def test_a_folder_of_another_user_is_passed_over(parent, monkeypatch):
    other = parent / "other"
    other.mkdir(0o700)
    os.chown(other, OTHER_UID, OTHER_UID)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(other))
    assert made()[0].parent == parent


@pytest.mark.multiprocess
def test_the_folder_of_a_killed_process_is_removed_by_the_next_one(parent):
    """A program that the killed process has started and that lives does not hold the folder."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        try:
            path = Path(holder.stdout.readline().strip())
            made()
            assert {each.name for each in path.iterdir()} == {"radio", LOCK}
        finally:
            holder.kill()
    made()
    assert list(parent.iterdir()) == []


def test_folders_without_a_lock_file_are_removed_when_they_are_old(parent):
    young, old = parent / "coflight-radio-young", parent / "coflight-radio-old"
    for each in (young, old):
        each.mkdir()
    past_s = old.stat().st_mtime - KEPT_S - 1.0
    os.utime(old, (past_s, past_s))
    made()
    assert list(parent.iterdir()) == [young]


@root_only
def test_folders_of_other_users_are_kept(parent):
    other, link = parent / "coflight-radio-other", parent / "coflight-radio-link"
    other.mkdir()
    (other / LOCK).touch()
    link.symlink_to(parent)
    os.chown(other, OTHER_UID, OTHER_UID)
    made()
    assert {*parent.iterdir()} == {other, link}

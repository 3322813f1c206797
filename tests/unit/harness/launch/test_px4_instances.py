"""PX4s in the way of a swarm's: by their locks, their users and their ports."""

import fcntl
import os
import socket
import subprocess
import sys

import pytest

from harness.launch import px4_instances
from harness.launch.px4_instances import LINK_PORTS, LOCK, SHELL, check_free, remove_files
from harness.launch.resources import ResourceError

HOST = "127.0.0.1"
HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "w")
fcntl.lockf(file, fcntl.LOCK_EX)
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(px4_instances, "FOLDER", tmp_path)
    # ports above those of any other test
    monkeypatch.setattr(px4_instances, "LINK_PORTS", (31_000, 31_500))
    return tmp_path


def test_an_instance_without_files_is_free(folder):
    check_free(3, HOST)
    assert list(folder.iterdir()) == []


def test_files_of_a_px4_that_has_ended_are_not_in_the_way(folder):
    (folder / f"{LOCK}3").touch()
    (folder / f"{SHELL}3").touch()
    check_free(3, HOST)


def test_a_running_px4_is_named_by_its_process(folder):
    lock = folder / f"{LOCK}3"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(lock)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as px4:
        assert px4.stdout.readline() == b"locked\n"
        with pytest.raises(
            ResourceError, match=rf"^PX4 instance 3 is running as process {px4.pid}$"
        ) as caught:
            check_free(3, HOST)
        assert caught.value.in_use
        check_free(4, HOST)
        px4.stdin.close()
        px4.wait(10.0)
    check_free(3, HOST)


@pytest.mark.parametrize("name", [LOCK, SHELL])
def test_files_of_another_user_are_in_the_way_except_of_root(folder, monkeypatch, name):
    (folder / f"{name}3").touch()
    owner = (folder / f"{name}3").stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(ResourceError, match=f"{name}3: of another user's PX4"):
        check_free(3, HOST)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    check_free(3, HOST)


@pytest.mark.parametrize("which", range(len(LINK_PORTS)))
def test_ports_of_its_other_links_have_to_be_free(which):
    port = px4_instances.LINK_PORTS[which] + 3
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HOST, port))
        with pytest.raises(ResourceError, match=f"^UDP port {port} on {HOST}"):
            check_free(3, HOST)


def test_files_are_removed_unless_a_px4_of_the_number_runs(folder):
    lock, shell = folder / f"{LOCK}3", folder / f"{SHELL}3"
    for path in (lock, shell, folder / f"{SHELL}4"):
        path.touch()
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(lock)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as running:
        assert running.stdout.readline() == b"locked\n"
        remove_files([3])
        assert lock.exists()
        assert shell.exists()
        running.stdin.close()
        running.wait(10.0)
    remove_files([3])
    remove_files([3])
    assert [path.name for path in folder.iterdir()] == [f"{SHELL}4"]


def test_the_lock_is_read_without_being_taken(folder):
    lock = folder / f"{LOCK}3"
    lock.touch()
    check_free(3, HOST)
    with lock.open("w") as file:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

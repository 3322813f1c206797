"""`coflight shell` names what is missing, and takes the newest swarm that lives."""

import os

import pytest

from foundation.exit_status import BAD_INPUT
from harness.cli import shell
from harness.launch.vehicle_network import write_holders


@pytest.fixture
def runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "runs"


def swarm(runs, name, age_s, holders):
    """Make the file of a swarm's network."""
    folder = runs / name
    folder.mkdir(parents=True)
    write_holders(folder / "network.json", holders)
    changed_s = (folder / "network.json").stat().st_mtime - age_s
    os.utime(folder / "network.json", (changed_s, changed_s))
    return folder


def end(folder):
    """Make its processes ones that have ended."""
    path = folder / "network.json"
    path.write_bytes(path.read_bytes().replace(b'"started_s":1', b'"started_s":2'))


@pytest.fixture
def executed(monkeypatch):
    found = []

    def execute(_path, command):
        found.append(command)
        raise SystemExit(0)

    monkeypatch.setattr(os, "execv", execute)
    return found


def test_newest_living_swarm_is_entered(runs, executed):
    swarm(runs, "living", 100.0, {"0": os.getpid(), "1": os.getppid()})
    end(swarm(runs, "killed", 1.0, {"0": os.getpid()}))
    with pytest.raises(SystemExit):
        shell.main(["1", "--", "ping", "-c", "1", "10.1.0.0"])
    assert executed[0][-5:] == [str(os.getppid()), "ping", "-c", "1", "10.1.0.0"]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["0"], "coflight: runs/: no running swarm with [[programs]] or [network]; name its folder by --run"),
        (["0", "--run", "nowhere"], "coflight: nowhere: no running swarm with [[programs]] or [network]"),
        (["7", "--run", "runs/living"], "coflight: runs/living: there is no UAV 7 among 1"),
        (["0", "--run", "runs/killed"], "coflight: runs/killed: its swarm has ended"),
    ],
)
def test_what_is_missing_is_named(runs, capsys, arguments, line):
    if arguments != ["0"]:
        swarm(runs, "living", 0.0, {"0": os.getpid()})
        end(swarm(runs, "killed", 0.0, {"0": os.getpid()}))
    assert shell.main(arguments) == BAD_INPUT
    assert capsys.readouterr().err == f"{line}\n"

"""Folders of the runs of tests: names, claims, what is replaced and what is removed."""

import fcntl
import shutil
from pathlib import Path

import pytest

from harness.launch.pytest_folders import claim, name_of, tidy

NODEID = "tests/test_swarm.py::TestWind::test_hover[2/wind]"


def test_a_name_has_readable_words_and_no_separator():
    name = name_of(NODEID)
    assert name.startswith("test_swarm-TestWind-test_hover-2-wind-")
    assert name == name_of(NODEID)


def test_tests_that_differ_in_one_character_have_different_names():
    nodeids = [f"tests/test_swarm.py::test_hover[a{mark}b]" for mark in "-/: _ü"]
    nodeids += ["other/test_swarm.py::test_hover[a-b]", f"test_swarm.py::test[{'x' * 300}]"]
    names = {name_of(nodeid) for nodeid in nodeids}
    assert len(names) == len(nodeids)
    assert max(map(len, names)) < 100


def test_swarms_of_one_test_have_different_folders(tmp_path):
    first, second = claim(tmp_path, NODEID), claim(tmp_path, NODEID)
    assert first.path.name == name_of(NODEID)
    assert second.path.name == f"{name_of(NODEID)}-2"
    first.remove()
    second.remove()
    tidy(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_kept_folder_is_replaced_when_its_test_runs_again(tmp_path):
    places = [claim(tmp_path, NODEID) for _ in range(3)]
    other = claim(tmp_path, "tests/test_swarm.py::test_other")
    for place in [*places, other]:
        (place.path / "logs").mkdir(parents=True)
        (place.path / "manifest.json").touch()
        place.keep()
        assert sorted(path.name for path in place.path.iterdir()) == ["logs", "manifest.json"]
    again = claim(tmp_path, NODEID)
    assert again.path == places[0].path
    assert again.is_empty
    assert {path.name for path in tmp_path.iterdir()} - {".claims"} == {other.path.name}
    again.remove()


def test_a_folder_in_use_is_left_to_its_swarm(tmp_path):
    theirs = tmp_path / f"{name_of(NODEID)}-2"  # of another session
    theirs.mkdir()
    claims = tmp_path / ".claims"
    claims.mkdir()
    with (claims / theirs.name).open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        places = [claim(tmp_path, NODEID) for _ in range(2)]
        assert [place.path.name for place in places] == [name_of(NODEID), f"{name_of(NODEID)}-3"]
    assert theirs.exists()
    for place in places:
        place.remove()


def test_a_folder_that_its_test_has_removed_is_empty(tmp_path):
    place = claim(tmp_path, NODEID)
    place.path.mkdir()
    assert not place.is_empty
    shutil.rmtree(place.path)
    assert place.is_empty
    place.keep()
    tidy(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_descriptors_are_closed(tmp_path):
    before = len(list(Path("/proc/self/fd").iterdir()))
    kept, removed = claim(tmp_path, NODEID), claim(tmp_path, NODEID)
    kept.keep()
    removed.remove()
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_an_own_folder_is_hidden_from_git_and_removed_with_its_last_run(tmp_path):
    out = tmp_path / "runs"
    place = claim(out, NODEID)
    assert "*" in (out / ".gitignore").read_text().splitlines()
    tidy(out)
    assert out.exists()
    place.remove()
    tidy(out)
    assert not out.exists()


def test_a_folder_of_the_user_is_never_removed(tmp_path):
    claim(tmp_path, NODEID).remove()
    tidy(tmp_path)
    assert tmp_path.exists()
    tidy(tmp_path / "absent")


def test_a_folder_that_cannot_be_made_is_an_os_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        claim(tmp_path / "file", NODEID)

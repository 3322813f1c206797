"""Files and folders that only their owner can read have these rights under every umask."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from foundation.records.private_files import make_private, write_private
from foundation.records.whole_file import write_whole


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(params=[0o000, 0o022, 0o077], ids=oct)
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def test_a_new_folder_is_private_and_its_new_parents_are_not_writable_by_others(
    umask: int, tmp_path: Path
) -> None:
    make_private(tmp_path / "runs" / "deeper" / "run")
    assert mode(tmp_path / "runs" / "deeper" / "run") == 0o700
    assert mode(tmp_path / "runs") == mode(tmp_path / "runs" / "deeper") == 0o755 & ~umask


@pytest.mark.usefixtures("umask")
def test_a_folder_that_exists_keeps_its_rights(tmp_path: Path) -> None:
    wide = tmp_path / "wide"
    wide.mkdir()
    wide.chmod(0o755)
    make_private(wide, exist_ok=True)
    assert mode(wide) == 0o755
    with pytest.raises(FileExistsError):
        make_private(wide)
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        make_private(tmp_path / "file", exist_ok=True)


@pytest.mark.usefixtures("umask")
def test_a_private_file_replaces_one_that_others_can_read_or_that_is_a_link(tmp_path: Path) -> None:
    target, theirs = tmp_path / "settings", tmp_path / "theirs"
    theirs.touch()
    for leave in (target.touch, lambda: target.symlink_to(theirs)):
        target.unlink(missing_ok=True)
        leave()
        write_private(target, b"new")
        assert (mode(target), target.read_bytes(), target.is_symlink()) == (0o600, b"new", False)
    assert theirs.read_bytes() == b""


@pytest.mark.usefixtures("umask")
def test_a_whole_private_file_is_private_whatever_a_killed_writer_has_left(tmp_path: Path) -> None:
    target, left = tmp_path / "manifest.json", tmp_path / ".manifest.json"
    for path in (target, left):
        path.touch()
        path.chmod(0o666)
    write_whole(target, b"{}", private=True)
    assert (mode(target), target.read_bytes()) == (0o600, b"{}")
    assert not left.exists()

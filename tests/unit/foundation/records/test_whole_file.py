"""Files that are written as a whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from foundation.records.whole_file import whole_file, write_whole
from foundation.system_error import in_words


@pytest.mark.parametrize("private", [False, True])
def test_a_full_disk_is_an_error_with_the_files_name_that_leaves_the_old_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, private: bool
) -> None:
    path = tmp_path / "manifest.json"
    write_whole(path, b"old", private=private)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left on device") as raised:
        write_whole(path, b"new", private=private)
    assert in_words(raised.value) == f"{path}: No space left on device"
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"old"]


def test_an_error_that_has_a_name_keeps_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        write_whole(tmp_path / "none" / "file", b"")
    assert raised.value.filename == str(tmp_path / "none" / ".file")


def test_a_writer_publishes_no_part_of_a_file_that_another_writes(tmp_path: Path) -> None:
    path = tmp_path / "file"
    first, second = whole_file(path, private=True), whole_file(path, private=True)
    first.__enter__().write(b"first")
    file = second.__enter__()
    file.write(b"sec")
    file.flush()
    with pytest.raises(FileExistsError, match="another program"):
        first.__exit__(None, None, None)
    assert not path.exists()
    file.write(b"ond")
    second.__exit__(None, None, None)
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("file", b"second")]

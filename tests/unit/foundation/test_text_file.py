"""Files that cannot be read as text are named with the reason in words."""

import os

import pytest

from foundation import text_file
from foundation.text_file import TextFileError, read_text


def test_a_text_is_read_without_its_byte_order_mark(tmp_path):
    file = tmp_path / "a.txt"
    file.write_bytes(b"\xef\xbb\xbfagents = 3 # \xc3\xbc\n")
    assert read_text(file) == "agents = 3 # ü\n"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("absent", "there is no such file"),
        ("file/below", "a part of the path is a file, not a folder"),
        ("folder", "it is a folder, not a file"),
        ("n" * 300, "the name is too long"),
        ("loop", "it is a symbolic link to itself"),
        ("binary", "it is not text (UTF-8)"),
        ("null\0byte", "this is no path of a file"),
    ],
)
def test_the_reason_is_in_words(tmp_path, name, reason):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TextFileError) as caught:
        read_text(tmp_path / name)
    text = str(caught.value)
    assert text.endswith(f": {reason}")
    assert name.partition("\0")[0] in text
    assert "\n" not in text
    assert "Errno" not in text


@pytest.mark.skipif(os.getuid() == 0, reason="root reads every file")
def test_a_file_of_another_user_is_refused(tmp_path):
    file = tmp_path / "secret"
    file.touch(mode=0)
    with pytest.raises(TextFileError, match="this user may not read it"):
        read_text(file)


def test_a_file_without_end_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(text_file, "MOST_BYTES", 2_000_000)
    large = tmp_path / "large"
    large.write_bytes(b"a" * 2_000_001)
    with pytest.raises(TextFileError, match="it is larger than 2 MB"):
        read_text(large)
    large.write_bytes(b"a" * 2_000_000)
    assert len(read_text(large)) == 2_000_000

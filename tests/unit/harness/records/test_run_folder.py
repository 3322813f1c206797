"""A run gets a folder of its own, holds it, and leaves none behind if its flight has not begun."""

from pathlib import Path

import pytest

from harness.records import run_folder
from harness.records.run_folder import FolderRefused, NotARun, RunFolder


def tree(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize(
    ("names", "content"),
    [
        (["notes.txt"], "holds notes.txt, and"),
        (["a", "b", "c", "d", "e"], "holds a, b, c and 2 more, and"),
        (["config", "logs", "manifest.json"], "holds a run already, and"),
    ],
)
def test_a_folder_with_content_is_refused_and_stays_as_it_is(
    names: list[str], content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path, Path()):
        folder = RunFolder(path)
        with pytest.raises(FolderRefused) as refused:
            folder.create()
        assert f"{tmp_path} {content}" in str(refused.value)
        assert "name a new or an empty one with --out" in str(refused.value)
        folder.discard()
        assert tree(tmp_path) == sorted(names)


@pytest.mark.parametrize("place", ["file", "file/below", "n" * 300, f"new/{'n' * 300}"])
def test_a_path_that_cannot_be_a_folder_is_refused_with_the_option(place: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    folder = RunFolder(tmp_path / place)
    with pytest.raises(FolderRefused) as refused:
        folder.create()
    line = str(refused.value)
    assert line.startswith(f"{tmp_path / place}: cannot be the folder of a run: ")
    assert line.endswith("with --out (in Python, out=)")
    assert "Errno" not in line
    folder.discard()
    assert tree(tmp_path) == ["file"]


def test_a_discarded_run_leaves_what_was_there_before(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for place in ("empty", "new/deeper/run"):
        folder = RunFolder(tmp_path / place).create()
        folder.raw_truth.touch()
        folder.events.touch()
        folder.discard()
    assert tree(tmp_path) == ["empty"]


def test_a_discarded_run_leaves_other_runs(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "runs" / "one").create()
    RunFolder(tmp_path / "runs" / "other").create()
    folder.discard()
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["other"]


def test_of_two_runs_that_begin_at_once_in_a_folder_the_first_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = RunFolder(tmp_path / "run"), RunFolder(tmp_path / "run")
    monkeypatch.setattr(run_folder, "names_in", lambda _: [])  # what both have seen
    first.create()
    first.events.touch()
    with pytest.raises(FolderRefused, match="File exists"):
        second.create()
    second.discard()
    assert tree(tmp_path / "run") == ["config", "events.jsonl", "figures", "logs", "raw"]


def test_raw_logs_are_held_by_one_program_at_a_time(tmp_path: Path) -> None:
    flying, reporting = RunFolder(tmp_path).create(), RunFolder(tmp_path)
    with flying.held():
        pass  # it still holds them afterwards
    with pytest.raises(NotARun, match="in flight"), reporting.held():
        pass
    flying.release()
    with reporting.held(), pytest.raises(NotARun), RunFolder(tmp_path).held():
        pass
    with RunFolder(tmp_path).held():
        pass

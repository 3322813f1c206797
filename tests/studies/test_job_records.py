"""Results of jobs in a file: a validation that is broken off goes on where it was."""

from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer

from studies.common.command_line import Page, Validation
from studies.common.job_records import JobRecords
from studies.common.record_lines import RecordsError
from studies.common.report import Check, Section
from studies.common.runner import Job, Results, Subject, run_subjects
from studies.soak.swarms_section import ManySwarms

MARKS = "marks.txt"


def mark(folder: str, number: int) -> ManySwarms:
    """Write down that the job has run; its result is of nested types."""
    with Path(folder, MARKS).open("a", encoding="utf-8") as file:
        file.write(f"{number}\n")
    if number == 3:
        raise ValueError("the third job")
    return ManySwarms(measured=[], left_processes=number, left_folders=0)


def jobs(folder: Path) -> dict[str, list[Job]]:
    return {"all": [partial(mark, str(folder), number) for number in range(1, 5)]}


def judge(_plan: Any, results: Results) -> Section:
    left = [one.left_processes for one in results["all"]]
    return Section(title="T", conditions="", checks=(Check("sum", sum(left), at_most=10.0),))


def run(folder: Path, records: JobRecords) -> list[tuple[str, int, int]]:
    seen: list[tuple[str, int, int]] = []
    subjects = {"marks": Subject(jobs, judge)}
    run_subjects(folder, subjects, progress=lambda *each: seen.append(each), records=records)
    return seen


def marks(folder: Path) -> list[int]:
    return sorted(int(line) for line in (folder / MARKS).read_text(encoding="utf-8").split())


def test_jobs_with_results_are_not_run_again(tmp_path: Path) -> None:
    records = JobRecords(tmp_path / "records", "abc")
    for number in (1, 2, 4):
        (job,) = (job for job in jobs(tmp_path)["all"] if job.args[1] == number)
        assert records.result(job) is None
        records.add(job, ManySwarms(measured=[], left_processes=number, left_folders=0))
    again = JobRecords(tmp_path / "records", "def")
    again.add(partial(mark, str(tmp_path), 3), ManySwarms(measured=[], left_processes=3, left_folders=0))
    assert run(tmp_path, again) == []
    assert not (tmp_path / MARKS).exists()
    assert again.commits_of(jobs(tmp_path)["all"]) == ["abc", "def"]
    assert again.commits_of(jobs(tmp_path)["all"][:2]) == ["abc"]
    assert again.commits_of([partial(mark, str(tmp_path), 5), *jobs(tmp_path)["all"]]) == ["abc", "def"]
    assert again.result(partial(mark, str(tmp_path), 4)) == ManySwarms(
        measured=[], left_processes=4, left_folders=0
    )
    assert again.result(partial(mark, str(tmp_path), 5)) is None


def test_a_run_that_is_broken_off_keeps_the_results_so_far(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="the third job"):
        run(tmp_path, JobRecords(tmp_path / "records", "abc"))
    before = marks(tmp_path)
    assert before == [1, 2, 3, 4]  # those after the error, too
    with pytest.raises(ValueError, match="the third job"):
        run(tmp_path, JobRecords(tmp_path / "records", "abc"))
    assert marks(tmp_path) == [1, 2, 3, 3, 4]


def test_a_last_line_that_is_half_written_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "records"
    first = jobs(tmp_path)["all"][0]
    JobRecords(path, "abc").add(first, ManySwarms(measured=[], left_processes=1, left_folders=0))
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:20])
    records = JobRecords(path, "abc")
    assert path.read_bytes() == whole
    assert records.result(first).left_processes == 1


@pytest.mark.parametrize("content", ["{}\n", "no JSON\n", "\xff\n", '{"important": 1}', "a line\nrest", "x"])
def test_another_file_is_refused_and_kept(tmp_path: Path, content: str) -> None:
    path = tmp_path / "records"
    path.write_text(content, encoding="latin-1")
    with pytest.raises(RecordsError, match=r"records, line 1: .*; give another file$"):
        JobRecords(path, "abc")
    assert path.read_text(encoding="latin-1") == content


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    with pytest.raises(RecordsError, match="No such file or directory"):
        JobRecords(tmp_path / "none" / "records", "abc")


def test_a_page_of_pieces_names_their_commits(tmp_path: Path) -> None:
    records = JobRecords(tmp_path / "records", "abc12345")
    for job in jobs(tmp_path)["all"]:
        records.add(job, ManySwarms(measured=[], left_processes=job.args[1], left_folders=0))
    validation: Validation[Path] = Validation(
        program="study", page=Page(file_name="page.md", title="P", introduction="I\n"),
        subjects={"marks": Subject(jobs, judge)}, has_kernels=False,
    )  # fmt: skip
    with pytest.raises(typer.Exit) as ended:
        validation.run(tmp_path, "marks", out=tmp_path, json=True, records=tmp_path / "records")
    assert ended.value.exit_code == 0
    assert "with the commits abc12345." in (tmp_path / "page.md").read_text(encoding="utf-8")


def test_arguments_by_name_are_refused(tmp_path: Path) -> None:
    """Two jobs that differ in them would share a result."""
    with pytest.raises(ValueError, match="by position"):
        JobRecords(tmp_path / "records", "abc").result(partial(mark, folder="x", number=1))

"""Run all jobs of a validation in worker processes and judge the results of each subject."""

from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from typing import Any, Generic, TypeVar

from msgspec import Struct

from studies.common.job_records import JobRecords
from studies.common.report import Section

WORKERS = 2
P = TypeVar("P")
"""Plan: number and length of the measurements."""

Job = partial[Any]
"""Of a function at module level, because it is pickled for another process."""
Results = dict[str, list[Any]]


class Subject(Struct, Generic[P], frozen=True):
    """Subject that can be validated by itself: its jobs by group, and the judgement of their results."""

    jobs: Callable[[P], dict[str, list[Job]]]
    judge: Callable[[P, Results], Section]
    """Arguments: plan, results in the order of the jobs"""


def run_subjects(
    plan: P,
    subjects: Mapping[str, Subject[P]],
    *,
    progress: Callable[[str, int, int], None],
    records: JobRecords | None = None,
    workers: int = WORKERS,
) -> dict[str, Section]:
    """Run the jobs of the subjects and judge their results.

    ``progress`` is called with the subject, the number of its finished jobs and their total;
    ``workers`` jobs run at a time. Jobs whose results are in ``records`` are not run, and the results of the
    others are added. Raises RecordsError, and the first error of a job: with records once all jobs have
    ended, else without those that wait.
    """
    results: dict[str, Results] = {}
    done = dict.fromkeys(subjects, 0)
    with ProcessPoolExecutor(workers) as pool:
        waiting = {}
        for name, subject in subjects.items():
            groups = subject.jobs(plan)
            results[name] = {group: [None] * len(jobs) for group, jobs in groups.items()}
            for group, jobs in groups.items():
                for index, job in enumerate(jobs):
                    recorded = None if records is None else records.result(job)
                    if recorded is None:
                        waiting[pool.submit(job)] = (name, group, index, job)
                    else:
                        results[name][group][index] = recorded
                        done[name] += 1
        total = {name: sum(map(len, results[name].values())) for name in subjects}
        first_error: BaseException | None = None
        for future in as_completed(waiting):
            name, group, index, job = waiting[future]
            if (error := future.exception()) is not None:
                first_error = first_error or error
                if records is None:
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise error
                continue
            results[name][group][index] = future.result()
            if records is not None:
                records.add(job, future.result())
            done[name] += 1
            progress(name, done[name], total[name])
        if first_error is not None:
            raise first_error
    return {name: subject.judge(plan, results[name]) for name, subject in subjects.items()}

"""Run all jobs of a validation in worker processes and judge the results of each subject."""

from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from typing import Any, Generic, TypeVar

from msgspec import Struct

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
    plan: P, subjects: Mapping[str, Subject[P]], *, progress: Callable[[str, int, int], None]
) -> dict[str, Section]:
    """Run the jobs of the subjects and judge their results.

    ``progress`` is called with the subject, the number of its finished jobs and their total.
    """
    results: dict[str, Results] = {}
    with ProcessPoolExecutor(WORKERS) as pool:
        waiting = {}
        for name, subject in subjects.items():
            groups = subject.jobs(plan)
            results[name] = {group: [None] * len(jobs) for group, jobs in groups.items()}
            for group, jobs in groups.items():
                for index, job in enumerate(jobs):
                    waiting[pool.submit(job)] = (name, group, index)
        total = {name: sum(map(len, results[name].values())) for name in subjects}
        done = dict.fromkeys(subjects, 0)
        for future in as_completed(waiting):
            name, group, index = waiting[future]
            results[name][group][index] = future.result()
            done[name] += 1
            progress(name, done[name], total[name])
    return {name: subject.judge(plan, results[name]) for name, subject in subjects.items()}

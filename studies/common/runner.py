"""All jobs of a validation in worker processes, and their judgement subject by subject."""

from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Generic, TypeVar

from msgspec import Struct

from studies.common.report import Section

WORKERS = 2
P = TypeVar("P")
"""A plan: how much is measured."""

Job = tuple[Callable[[Any], Any], Any]
"""A function of a module, for it goes to another process, and its argument."""
Results = dict[str, list[Any]]


class Subject(Struct, Generic[P], frozen=True):
    """What can be validated on its own: its jobs by group, and what is made of them."""

    jobs: Callable[[P], dict[str, list[Job]]]
    judge: Callable[[P, Results, Path | None], Section]
    """Given the results in the jobs' order, and the folder for figures, if they are wanted"""


def run_subjects(
    plan: P,
    subjects: Mapping[str, Subject[P]],
    *,
    images: Path | None,
    progress: Callable[[str, int, int], None],
) -> list[Section]:
    """Do what the subjects need, and judge it.

    ``progress`` is told the subject, how many of its jobs are done, and how many there are.
    """
    results: dict[str, Results] = {}
    with ProcessPoolExecutor(WORKERS) as pool:
        waiting = {}
        for name, subject in subjects.items():
            groups = subject.jobs(plan)
            results[name] = {group: [None] * len(jobs) for group, jobs in groups.items()}
            for group, jobs in groups.items():
                for index, (function, argument) in enumerate(jobs):
                    waiting[pool.submit(function, argument)] = (name, group, index)
        total = {name: sum(map(len, results[name].values())) for name in subjects}
        done = dict.fromkeys(subjects, 0)
        for future in as_completed(waiting):
            name, group, index = waiting[future]
            results[name][group][index] = future.result()
            done[name] += 1
            progress(name, done[name], total[name])
    if images is not None:
        images.mkdir(parents=True, exist_ok=True)
    return [subject.judge(plan, results[name], images) for name, subject in subjects.items()]

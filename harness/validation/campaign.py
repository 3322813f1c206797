"""All flights of a validation in worker processes, and their judgement section by section."""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from msgspec import Struct

from harness.validation import attitude_sections, estimation_section, hover_section, move_section
from harness.validation.plan import Job, Plan, Results
from harness.validation.report import Section

WORKERS = 2


class Subject(Struct, frozen=True):
    """What can be validated on its own: its flights by group, and what is made of them."""

    jobs: Callable[[Plan], dict[str, list[Job]]]
    judge: Callable[[Plan, Results, Path | None], Section]
    """Given the results in the jobs' order, and the folder for figures, if they are wanted"""


SUBJECTS: dict[str, Subject] = {
    "px4": Subject(hover_section.px4_jobs, hover_section.judge_px4),
    "hover": Subject(hover_section.hover_jobs, hover_section.judge_hover),
    "steps": Subject(move_section.jobs, move_section.judge),
    "upsets": Subject(attitude_sections.upset_jobs, attitude_sections.judge_upsets),
    "allocation": Subject(attitude_sections.allocation_jobs, attitude_sections.judge_allocation),
    "estimator": Subject(estimation_section.jobs, estimation_section.judge),
}


def run(
    plan: Plan, subjects: Sequence[str], *, images: Path | None, progress: Callable[[str, int, int], None]
) -> list[Section]:
    """Fly what the subjects need, and judge it.

    ``progress`` is told the subject, how many of its flights are done, and how many there are.
    """
    results: dict[str, Results] = {}
    with ProcessPoolExecutor(WORKERS) as pool:
        waiting = {}
        for subject in subjects:
            groups = SUBJECTS[subject].jobs(plan)
            results[subject] = {group: [None] * len(jobs) for group, jobs in groups.items()}
            for group, jobs in groups.items():
                for index, (function, argument) in enumerate(jobs):
                    waiting[pool.submit(function, argument)] = (subject, group, index)
        total = {name: sum(len(jobs) for jobs in results[name].values()) for name in subjects}
        done = dict.fromkeys(subjects, 0)
        for future in as_completed(waiting):
            subject, group, index = waiting[future]
            results[subject][group][index] = future.result()
            done[subject] += 1
            progress(subject, done[subject], total[subject])
    if images is not None:
        images.mkdir(parents=True, exist_ok=True)
    return [SUBJECTS[subject].judge(plan, results[subject], images) for subject in subjects]

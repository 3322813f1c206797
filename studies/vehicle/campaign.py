"""Subjects of the validation of one vehicle."""

from collections.abc import Callable, Sequence
from pathlib import Path

from studies.common.report import Section
from studies.common.runner import Subject, run_subjects
from studies.vehicle import attitude_sections, estimation_section, hover_section, move_section
from studies.vehicle.plan import VehiclePlan

SUBJECTS: dict[str, Subject[VehiclePlan]] = {
    "px4": Subject(hover_section.px4_jobs, hover_section.judge_px4),
    "hover": Subject(hover_section.hover_jobs, hover_section.judge_hover),
    "steps": Subject(move_section.jobs, move_section.judge),
    "upsets": Subject(attitude_sections.upset_jobs, attitude_sections.judge_upsets),
    "allocation": Subject(attitude_sections.allocation_jobs, attitude_sections.judge_allocation),
    "estimator": Subject(estimation_section.jobs, estimation_section.judge),
}


def run(
    plan: VehiclePlan,
    subjects: Sequence[str],
    *,
    images: Path | None,
    progress: Callable[[str, int, int], None],
) -> list[Section]:
    """Fly and judge the named subjects: see `run_subjects`."""
    chosen = {name: SUBJECTS[name] for name in subjects}
    return run_subjects(plan, chosen, images=images, progress=progress)

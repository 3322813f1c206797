"""What measuring a statement gives."""

from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from studies.article.comparison import TOLD_APART, ComparedEstimate, holds


class Finding(Struct, frozen=True, kw_only=True):
    """Numbers as text, and whether they meet the criterion."""

    found: str
    agrees: bool | None
    """None: the flights are too few, or differ too much, to tell."""
    why: str = ""
    """Why not, backed by numbers; read where it does not agree."""


def by_margins(
    margins: Mapping[str, ComparedEstimate], *, found: str, why: str = "", unit: str = " dB", digits: int = 3
) -> Finding:
    """Judge by how far numbers are inside their bounds, each by its name; negative ones are outside.

    ``why`` is read where the statement does not hold, after the numbers that are outside.
    """
    agrees = holds(margins.values())
    blamed = {name: margin for name, margin in margins.items() if margin.positive is agrees}
    if agrees is None:
        single = any(margin.error is None for margin in blamed.values())
        said = (
            "One flight, or one pair of them, has no standard error; inside the criterion by"
            if single
            else f"Within {TOLD_APART:g} standard errors of the criterion, inside it by"
        )
        return Finding(found=found, agrees=None, why=f"{said} {_listed(blamed, unit, digits)}.")
    if agrees:
        return Finding(found=found, agrees=True)
    outside = {name: replace(margin, value=-margin.value) for name, margin in blamed.items()}
    text = f"Outside the criterion by {_listed(outside, unit, digits)}. {why}"
    return Finding(found=found, agrees=False, why=text.rstrip())


def _listed(margins: Mapping[str, ComparedEstimate], unit: str, digits: int) -> str:
    return ", ".join(f"{margin.text(digits, unit)} ({name})" for name, margin in margins.items())

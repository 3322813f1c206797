"""Result of the measurement of a statement."""

from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from studies.article.comparison import DECIDED_ERRORS, ComparedEstimate, holds


class Finding(Struct, frozen=True, kw_only=True):
    """Numbers as text, and whether they meet the criterion."""

    found: str
    agrees: bool | None
    """None if undecided: too few flights, or too large differences between them."""
    why: str = ""
    """Reason with numbers, used if it does not agree"""


def by_margins(
    margins: Mapping[str, ComparedEstimate], *, found: str, why: str = "", unit: str = " dB", digits: int = 3
) -> Finding:
    """Return a finding from margins by name, the distances inside the bounds; negative margins are outside.

    ``why`` follows the numbers that are outside if the statement does not hold.
    """
    agrees = holds(margins.values())
    blamed = {name: margin for name, margin in margins.items() if margin.positive is agrees}
    if agrees is None:
        single = any(margin.error is None for margin in blamed.values())
        said = (
            "A single flight or pair of flights has no standard error; inside the criterion by"
            if single
            else f"Within {DECIDED_ERRORS:g} standard errors of the criterion, inside it by"
        )
        return Finding(found=found, agrees=None, why=f"{said} {_listed(blamed, unit, digits)}.")
    if agrees:
        return Finding(found=found, agrees=True)
    outside = {name: replace(margin, value=-margin.value) for name, margin in blamed.items()}
    text = f"Outside the criterion by {_listed(outside, unit, digits)}. {why}"
    return Finding(found=found, agrees=False, why=text.rstrip())


def _listed(margins: Mapping[str, ComparedEstimate], unit: str, digits: int) -> str:
    return ", ".join(f"{margin.text(digits, unit)} ({name})" for name, margin in margins.items())

"""What msgspec refuses, said in one line: the field's path and the reason."""

import re
from collections.abc import Mapping

import msgspec

_WORDS = {
    "Object contains unknown field": "unknown key",
    "Object missing": "object missing",
    "Expected": "expected",
    "Invalid": "invalid",
    " | null`": "`",
}
"""TOML has no null: a field that may be None is left out."""


def explain(error: msgspec.ValidationError, expected: Mapping[str, str], *, root: str = "") -> str:
    """``Expected `float` >= 0.0 - at `$.wind.mean_n``` becomes ``wind.mean_n: expected `float` >= 0.0``.

    ``expected`` says what is wanted where the type alone does not, by a pattern of the whole path, which
    begins with ``root``.
    """
    reason, at, where = str(error).rpartition(" - at `$")
    if not at:
        reason, where = str(error), ""
    where = f"{root}{where.rstrip('`')}".lstrip(".")
    for pattern, wanted in expected.items():
        if re.fullmatch(pattern, where):
            reason = re.sub(r"^Expected `\w+ \| [^`]*`", f"expected {wanted}", reason)
            if reason.startswith("Invalid"):
                reason = f"{reason}, expected {wanted}"
    for said, meant in _WORDS.items():
        reason = reason.replace(said, meant)
    return f"{where}: {reason}" if where else reason

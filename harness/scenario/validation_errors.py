"""Conversion of msgspec's validation errors to one line: the field's path and the reason."""

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
"""Replacements in msgspec's texts. TOML has no null: an optional field is omitted."""


def explain(error: msgspec.ValidationError, expected: Mapping[str, str], *, root: str = "") -> str:
    """Return ``wind.mean_n: expected `float` >= 0.0`` for ``Expected `float` >= 0.0 - at `$.wind.mean_n```.

    ``expected`` describes expected values where the type is not sufficient, by a pattern of the whole path,
    which begins with ``root``.
    """
    reason, at, where = str(error).rpartition(" - at `$")
    if not at:
        reason, where = str(error), ""
    where = f"{root}{where.rstrip('`')}".lstrip(".")
    for pattern, description in expected.items():
        if re.fullmatch(pattern, where):
            reason = re.sub(r"^Expected `\w+ \| [^`]*`", f"expected {description}", reason)
            if reason.startswith("Invalid"):
                reason = f"{reason}, expected {description}"
    for original, replacement in _WORDS.items():
        reason = reason.replace(original, replacement)
    return f"{where}: {reason}" if where else reason

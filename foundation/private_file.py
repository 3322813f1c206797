"""Files that only their owner may read, such as those with passwords."""

import os
from pathlib import Path

PRIVATE = 0o600
"""Mode of such a file."""


def write_private(path: Path, content: bytes) -> None:
    """Write a file of mode `PRIVATE`, which it has before the first byte. Raises OSError."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, PRIVATE)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, PRIVATE)  # of a file that existed
        file.write(content)

"""Reserve standard output for results."""

import os
import sys
from typing import TextIO


def keep_stdout() -> TextIO:
    """Return a stream for the results, and redirect standard output to standard error.

    Bullet prints a line on standard output, at its import or when the process ends.
    """
    sys.stdout.flush()
    stdout = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return stdout

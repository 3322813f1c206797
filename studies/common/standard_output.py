"""Standard output for results alone."""

import os
import sys
from typing import TextIO


def keep_stdout() -> TextIO:
    """Give a stream for the results, and let standard output be standard error for everybody else.

    Bullet prints a line of its own on standard output, at its import or when the process ends.
    """
    sys.stdout.flush()
    stdout = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return stdout

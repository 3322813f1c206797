"""Runs a command without the privilege of root to ignore the modes of files."""

import os
import shutil

import pytest


def obeying_modes(*command: str) -> list[str]:
    """Return the command, without root's privilege to write any file; skips the test if it cannot."""
    if os.geteuid() != 0:
        return [*command]
    if shutil.which("setpriv") is None:
        pytest.skip("root can write every file, and setpriv is not installed")
    return ["setpriv", "--bounding-set", "-dac_override", "--inh-caps", "-all", *command]

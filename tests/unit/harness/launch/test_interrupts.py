"""Ctrl-C while a command is being imported ends it with one line."""

import signal
import subprocess
import sys
from pathlib import Path

SWALLOWING = """
import os, signal
try:
    os.kill(os.getpid(), signal.SIGINT)
except BaseException:
    raise ImportError("as some modules convert it")
"""
COMMAND = """
import sys
from coflight import command
command.COMMANDS["fly"] = command.Command("", "swallowing", "main")
sys.exit(command.main(["fly"]))
"""


def test_ctrl_c_during_the_imports_of_a_command_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "swallowing.py").write_text(SWALLOWING)
    code = f"import sys; sys.path.append({str(tmp_path)!r}){COMMAND}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGINT
    assert (done.stdout, done.stderr) == ("", "coflight fly: broken off before the start\n")

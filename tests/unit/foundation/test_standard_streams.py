"""Output whose reader is gone is dropped, and the program goes on."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import sys
from rich.console import Console
from foundation.standard_streams import lasting_output, open_missing
open_missing()
with lasting_output():
    for i in range(20_000):
        print("line", i)
        Console(file=sys.stdout).print("table", i)
        print("line", i, file=sys.stderr)
open(sys.argv[1], "w").write(f"done {sys.stdout.isatty()} {sys.stdout.encoding}")
print("after")
"""


@pytest.fixture
def done(tmp_path):
    """Return the path that the program writes to when it is done."""
    return tmp_path / "done"


def test_reader_that_leaves_does_not_end_the_program(done):
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(done)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as program:
        assert program.stdout.readline() == b"line 0\n"
        program.stdout.close()
        program.stderr.close()
    assert program.returncode == 0
    assert done.read_text().startswith("done False")


def test_streams_that_are_closed_from_the_start_are_no_files_later(done):
    command = f'exec "{sys.executable}" -c "$0" "{done}" <&- >&- 2>&-'
    code = subprocess.run(["/bin/sh", "-c", command, PROGRAM], check=False, env=os.environ).returncode
    assert code == 0
    assert done.read_text().startswith("done False")

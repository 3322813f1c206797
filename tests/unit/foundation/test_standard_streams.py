"""Output whose reader is gone is dropped, and the program goes on."""

import os
import subprocess
import sys
from pathlib import Path

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


FULL = """
import sys
from foundation.standard_streams import lasting_output
try:
    with lasting_output():
        print("lost")
        sys.stdout.flush()
        print("more")
        print("goes on", file=sys.stderr)
except OSError as error:
    print(error.strerror, file=sys.stderr)
    sys.exit(1)
"""


def test_output_that_is_lost_on_a_full_disk_is_an_error_after_the_block():
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-c", FULL], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (1, "goes on\nNo space left on device\n")


@pytest.mark.parametrize("option", ["--help", "--json"])
def test_a_command_whose_output_is_lost_does_not_end_with_status_0(option):
    program = f"""
import sys
from harness.cli import fly
fly.app = lambda args, standalone_mode: print("summary")
sys.exit(fly.main([{option!r}]))
"""
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [sys.executable, "-c", program], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (1, "coflight: output is lost: No space left on device\n")


def test_child_processes_inherit_what_was_closed_before(done):
    program = "import os; from foundation.standard_streams import open_missing; open_missing(); "
    program += f"open({str(done)!r}, 'w').write(str([os.get_inheritable(n) for n in range(3)]))"
    command = f'exec "{sys.executable}" -c "$0" <&- >&- 2>&-'
    assert subprocess.run(["/bin/sh", "-c", command, program], check=False).returncode == 0
    assert done.read_text() == "[True, True, True]"

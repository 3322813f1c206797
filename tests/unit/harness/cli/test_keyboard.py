"""Keys are read from a terminal in the foreground, whose modes are restored; otherwise nothing changes."""

import subprocess
import sys

from paths import SUPPORT

CHILD = """
import os, sys, termios, threading
from harness.cli.keyboard import Keyboard
before = termios.tcgetattr(0)
received, done = [], threading.Event()
def on_key(key):
    received.append(key)
    if key == "!":
        raise KeyError("physics")
    if key == "q":
        done.set()
with Keyboard(on_key) as keyboard:
    print("listening" if keyboard.listening else "deaf", flush=True)
    done.wait(20.0)
print("".join(received), termios.tcgetattr(0) == before, flush=True)
"""
PARENT = f"""
import os, pty, sys
pid, terminal = pty.fork()
if pid == 0:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os.execv(sys.executable, [sys.executable, "-c", {CHILD!r}])
output = b""
while b"listening" not in output:
    output += os.read(terminal, 100)
os.write(terminal, b"!+-q")
while True:
    try:
        data = os.read(terminal, 100)
    except OSError:
        break
    if not data:
        break
    output += data
print(output.decode().split())
os.waitpid(pid, 0)
"""


def test_keys_are_read_without_echo_even_after_an_error_and_the_terminal_is_restored():
    done = subprocess.run(
        [sys.executable, "-c", PARENT], capture_output=True, text=True, timeout=30.0, check=True
    )
    assert done.stdout.strip() == "['listening', '!+-q', 'True']"


def test_a_run_in_the_background_does_not_use_the_terminal_and_reads_keys_when_it_is_back():
    done = subprocess.run(
        [sys.executable, str(SUPPORT / "job_control.py")],
        capture_output=True,
        text=True,
        timeout=100.0,
        check=False,
    )
    assert (done.returncode, done.stdout[-4:]) == (0, "fine"), done.stdout + done.stderr


def test_other_files_than_terminals_are_not_changed():
    script = (
        "from harness.cli.keyboard import Keyboard\n"
        "with Keyboard(print) as keyboard:\n    print(keyboard.listening, end='')"
    )
    for stdin in (subprocess.PIPE, subprocess.DEVNULL):
        done = subprocess.run(
            [sys.executable, "-c", script],
            stdin=stdin,
            stdout=subprocess.PIPE,
            text=True,
            timeout=30.0,
            check=True,
        )
        assert done.stdout == "False"

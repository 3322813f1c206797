"""Keys act on a terminal in the foreground, which is left as it was; anywhere else nothing is touched."""

import subprocess
import sys

from paths import SUPPORT

CHILD = """
import os, sys, termios, threading
from harness.cli.keyboard import Keyboard
before = termios.tcgetattr(0)
heard, done = [], threading.Event()
def on_key(key):
    heard.append(key)
    if key == "!":
        raise KeyError("physics")
    if key == "q":
        done.set()
with Keyboard(on_key) as keyboard:
    print("listening" if keyboard.listening else "deaf", flush=True)
    done.wait(20.0)
print("".join(heard), termios.tcgetattr(0) == before, flush=True)
"""
PARENT = f"""
import os, pty, sys
pid, terminal = pty.fork()
if pid == 0:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os.execv(sys.executable, [sys.executable, "-c", {CHILD!r}])
said = b""
while b"listening" not in said:
    said += os.read(terminal, 100)
os.write(terminal, b"!+-q")
while True:
    try:
        data = os.read(terminal, 100)
    except OSError:
        break
    if not data:
        break
    said += data
print(said.decode().split())
os.waitpid(pid, 0)
"""


def test_keys_are_heard_without_echo_even_after_one_that_fails_and_the_terminal_is_given_back():
    done = subprocess.run(
        [sys.executable, "-c", PARENT], capture_output=True, text=True, timeout=30.0, check=True
    )
    assert done.stdout.strip() == "['listening', '!+-q', 'True']"


def test_a_run_in_the_background_leaves_the_terminal_to_the_shell_and_hears_keys_when_it_is_back():
    done = subprocess.run(
        [sys.executable, str(SUPPORT / "job_control.py")],
        capture_output=True,
        text=True,
        timeout=100.0,
        check=False,
    )
    assert (done.returncode, done.stdout[-4:]) == (0, "fine"), done.stdout + done.stderr


def test_what_is_no_terminal_is_left_alone():
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

"""``python job_control.py``: a shell moves its job, a `Keyboard`, to the background and back.

Prints "fine", or ends with an AssertionError.
"""

import os
import pty
import select
import signal
import sys
import termios
import threading
import time
import tty

LIMIT_S = 20.0
LFLAG = 3
JOB = """
import os, sys
from harness.cli.keyboard import Keyboard
out, orders = map(int, sys.argv[1:])
with Keyboard(lambda key: os.write(out, key.encode())):
    os.write(out, b"listening ")
    os.read(orders, 1)
os.write(out, b"ended")
"""


def press(terminal, requests):
    """Type + at the terminal for every byte of ``requests``."""
    while os.read(requests, 1):
        os.write(terminal, b"+")


def wait_for(out, words):
    """Read the job's output until it contains some bytes."""
    received, deadline_s = b"", time.monotonic() + LIMIT_S
    while words not in received:
        assert select.select([out], [], [], max(0.0, deadline_s - time.monotonic()))[0], received
        received += os.read(out, 100)


def shell(request_key):
    """Control a job as a shell does; ``request_key`` requests a key press."""
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    tty.setcbreak(0)  # as a shell's line editor does
    out, their_out = os.pipe()
    orders, to_job = os.pipe()
    begin, start = os.pipe()
    job = os.fork()
    if job == 0:
        os.setpgid(0, 0)
        os.read(begin, 1)
        signal.signal(signal.SIGTTOU, signal.SIG_DFL)
        for number in (their_out, orders):
            os.set_inheritable(number, True)  # noqa: FBT003  its only form
        os.execv(sys.executable, [sys.executable, "-c", JOB, str(their_out), str(orders)])  # noqa: S606
    os.setpgid(job, job)
    os.tcsetpgrp(0, job)
    os.write(start, b".")
    wait_for(out, b"listening ")
    request_key()
    wait_for(out, b"+")

    os.tcsetpgrp(0, os.getpgrp())  # as after Ctrl-Z and bg: the shell receives the keys
    request_key()
    assert select.select([0], [], [], LIMIT_S)[0]
    time.sleep(1.0)  # several polls of the job
    assert os.waitpid(job, os.WNOHANG | os.WUNTRACED) == (0, 0)
    assert os.read(0, 10) == b"+"

    modes = termios.tcgetattr(0)
    modes[LFLAG] |= termios.ICANON
    termios.tcsetattr(0, termios.TCSANOW, modes)
    os.tcsetpgrp(0, job)  # as after fg
    request_key()
    wait_for(out, b"+")

    os.tcsetpgrp(0, os.getpgrp())
    tty.setcbreak(0)
    mine = termios.tcgetattr(0)
    os.write(to_job, b".")  # the job ends in the background and is not stopped
    wait_for(out, b"ended")
    _, status = os.waitpid(job, os.WUNTRACED)
    assert os.WIFEXITED(status), status
    assert termios.tcgetattr(0) == mine
    os.write(1, b"fine")


def main():
    requests, requesting = os.pipe()
    pid, terminal = pty.fork()
    if pid == 0:
        shell(lambda: os.write(requesting, b"."))
        sys.stdout.flush()
        os._exit(0)
    os.close(requesting)
    threading.Thread(target=press, args=(terminal, requests), daemon=True).start()
    printed = b""
    while True:
        try:
            data = os.read(terminal, 1000)
        except OSError:  # the shell has ended
            break
        if not data:
            break
        printed += data
    sys.stdout.write(printed.decode())
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


if __name__ == "__main__":
    sys.exit(main())

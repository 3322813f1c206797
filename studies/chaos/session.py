"""Program that gives a command a session with standard input as its terminal, and signals as a shell does.

``python -I -S session.py COMMAND...``: the process becomes the command. A new session is made before, by
`subprocess`; a function of this kind in the parent is not safe beside threads.
"""

import fcntl
import os
import signal
import sys
import termios

if __name__ == "__main__":
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    for number in (signal.SIGHUP, signal.SIGINT):  # a parent under nohup ignores them
        signal.signal(number, signal.SIG_DFL)
    os.execvp(sys.argv[1], sys.argv[1:])  # noqa: S606  the command is an argument

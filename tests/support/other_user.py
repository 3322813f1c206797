"""Code that runs as another user of the machine, in a forked process; only root can."""

import contextlib
import os
import signal
import traceback

import pytest

OTHER_UID = 65_534
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")


@contextlib.contextmanager
def as_other_user(act):
    """Run ``act`` in a process of another user; yields when it has returned, and ends it after the block.

    Its sockets stay open until then. An exception fails the test.
    """
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.setgid(OTHER_UID)
            os.setuid(OTHER_UID)
            kept = act()  # noqa: F841  sockets that would be closed
            os.write(writer, b"done")
            signal.pause()
        except BaseException:  # noqa: BLE001  reported below
            traceback.print_exc()
        finally:
            os._exit(1)
    os.close(writer)
    try:
        assert os.read(reader, 4) == b"done"
        yield pid
    finally:
        os.close(reader)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)

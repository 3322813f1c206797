"""A small disk in a mount namespace of its own, which other programs of the machine do not see."""

import contextlib
import os
import subprocess
from functools import cache
from pathlib import Path
from typing import Self

SIZE_MB = 16
"""Enough for a flight of the study with its tables and figures."""
_FILLER = "filler"
_MOUNT = f'mount -t tmpfs -o size={SIZE_MB}m,mode=700 tmpfs "$0" && echo mounted && exec cat'
_USER_OPTIONS = ((), ("--user", "--map-root-user"))


class SmallDisk:
    """A tmpfs at a folder, which only processes started by `command` find there; it ends with `close`.

    Raises OSError if the machine permits none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        for user in _USER_OPTIONS:
            # the namespace exists as long as this process, which ends with its standard input
            self._holder = subprocess.Popen(
                ["unshare", *user, "--mount", "sh", "-c", _MOUNT, str(folder)],  # noqa: S607  as on the PATH
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, process_group=0,
            )  # fmt: skip
            assert self._holder.stdout is not None  # noqa: S101  a pipe
            if self._holder.stdout.readline():
                self._with_user = bool(user)
                return
            self.close()
        raise OSError("no file system can be mounted in a namespace")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def command(self, command: list[str]) -> list[str]:
        """Return a command that runs ``command`` where the disk is, in the present working directory."""
        namespaces = f"/proc/{self._holder.pid}/ns"
        user = ["--preserve-credentials", f"--user={namespaces}/user"] if self._with_user else []
        enter = ["nsenter", *user, f"--mount={namespaces}/mnt"]
        return [*enter, "sh", "-c", 'cd "$0" && exec "$@"', str(Path.cwd()), *command]

    def path(self, path: Path) -> Path:
        """Return the path by which this process reaches a file of the disk."""
        return Path(f"/proc/{self._holder.pid}/root") / path.relative_to("/")

    def fill(self) -> None:
        """Write a file until no space is left."""
        with contextlib.suppress(OSError), self.path(self.folder / _FILLER).open("wb", buffering=0) as filler:
            for size in (1 << 20, 4_096):
                with contextlib.suppress(OSError):
                    while filler.write(bytes(size)):
                        pass

    def free(self) -> None:
        """Delete the file of `fill`."""
        self.path(self.folder / _FILLER).unlink(missing_ok=True)

    def close(self) -> None:
        """End the namespace, and with it the disk, once no process is left in it."""
        for stream in (self._holder.stdin, self._holder.stdout):
            if stream is not None:
                stream.close()
        self._holder.wait()


@cache
def is_permitted(folder: Path) -> bool:
    """Whether a small disk can be mounted at a new folder within ``folder``."""
    path = folder / f"disk-{os.getpid()}"
    try:
        with SmallDisk(path):
            return True
    except OSError:
        return False
    finally:
        path.rmdir()

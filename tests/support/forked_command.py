"""The command line in forks of one process with its modules: processes of their own without the imports."""

import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["coflight.command", "harness.cli.fly", "harness.cli.report"])
COMMAND = "import sys\nfrom coflight.command import main\nsys.exit(main())"


def run(
    arguments: Sequence[str], folder: Path, *, limit_s: float, environment: Mapping[str, str] | None = None,
    limits: Sequence[tuple[int, int]] = (), code: str = COMMAND,
) -> "subprocess.CompletedProcess[str]":  # fmt: skip
    """Run ``coflight ARGUMENTS`` in a folder, with further environment and limits of resources (setrlimit).

    ``code`` is the program in place of ``coflight``. Raises `subprocess.TimeoutExpired`.
    """
    with tempfile.TemporaryDirectory() as outputs:
        paths = [Path(outputs, name) for name in ("stdout", "stderr")]
        child = _CONTEXT.Process(
            target=_command,
            args=(list(arguments), folder, paths, dict(environment or {}), list(limits), code),
        )
        child.start()
        child.join(limit_s)
        if child.exitcode is None:
            child.kill()
            child.join()
            raise subprocess.TimeoutExpired(list(arguments), limit_s)
        texts = [path.read_text(encoding="utf-8") for path in paths]
    return subprocess.CompletedProcess(list(arguments), child.exitcode, *texts)


def _command(
    arguments: list[str], folder: Path, paths: list[Path], environment: dict[str, str],
    limits: list[tuple[int, int]], code: str,
) -> None:  # fmt: skip
    for stream, path in zip((sys.stdout, sys.stderr), paths, strict=True):
        with path.open("wb") as file:
            os.dup2(file.fileno(), stream.fileno())
    os.chdir(folder)
    os.environ.update(environment)
    for kind, value in limits:
        resource.setrlimit(kind, (value, value))
    sys.argv = ["coflight", *arguments]
    exec(code, {"__name__": "__main__"})  # noqa: S102  of a test

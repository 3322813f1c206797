"""What a process wrote about its end, and what the machine says about it, in words."""

import errno
import os
import re
import signal
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

FATAL = "Fatal Python error: "
_FRAME = re.compile(r'^  File "(?P<file>.*)", line (?P<line>\d+) in (?P<function>.*)$')
_CURRENT_THREAD = re.compile(r"^Current thread .*:$")
_FULL = {
    errno.ENOSPC: "no space left on the device of",
    errno.EDQUOT: "the disk quota is exceeded in",
    errno.EFBIG: "a file has reached the limit of sizes (ulimit -f) in",
}
_PROBE_BYTES = 65_536


def ending(returncode: int | None) -> str:
    """Return how a process ended, in words, from its exit status or minus the signal that killed it."""
    if returncode is None:
        return "ended with unknown status"
    if returncode >= 0:
        return f"ended with status {returncode}"
    try:
        name = signal.Signals(-returncode).name
    except ValueError:
        return f"was killed by signal {-returncode}"
    if -returncode == signal.SIGKILL:
        return f"was killed by {name}"
    return f"was killed by {name} ({(signal.strsignal(-returncode) or name).lower()})"


def last_words(lines: Sequence[str], returncode: int | None) -> str:
    """Return what a process wrote about its end, from the last lines of its stderr.

    After an exit status: up to two lines that begin with ERROR, the last of them, and then the last line.
    After a signal, the last line may be anything: the lines with ERROR, and of a trace of faulthandler the
    error and the innermost line of the program.
    """
    if returncode is None or returncode < 0:
        return "; ".join([*_marked(before_trace(lines)), *filter(None, [fatal_error(lines)])])
    return "; ".join(dict.fromkeys([*_marked(lines), *lines[-1:]]))


def _marked(lines: Iterable[str]) -> list[str]:
    return [line for line in lines if line.startswith("ERROR")][-2:]


def before_trace(lines: Sequence[str]) -> Sequence[str]:
    """Return the lines before the last trace of faulthandler."""
    begin = _trace(lines)
    return lines if begin is None else lines[:begin]


def fatal_error(lines: Sequence[str]) -> str:
    """Return the error of the last trace of faulthandler and the innermost line of its thread, or nothing."""
    begin = _trace(lines)
    if begin is None:
        return ""
    trace = iter(lines[begin + 1 :])
    for line in trace:
        if _CURRENT_THREAD.match(line):
            frame = _FRAME.match(next(trace, ""))
            if frame is not None:
                return "{}, in {} (line {} of {})".format(
                    lines[begin], frame["function"], frame["line"], frame["file"]
                )
            break
    return lines[begin]


def _trace(lines: Sequence[str]) -> int | None:
    """Return the index of the line with which the last trace of faulthandler begins."""
    return next((i for i in reversed(range(len(lines))) if lines[i].startswith(FATAL)), None)


def is_full(folder: Path, words: str) -> str | None:
    """Return why a folder takes no more data, as the beginning of a sentence; None if it does.

    ``words`` are those of a process that ended. A full disk often takes no words, so the folder is tried.
    """
    for number, full in _FULL.items():
        if os.strerror(number) in words:
            return full
    try:
        with tempfile.TemporaryFile(dir=folder, buffering=0) as probe:
            probe.write(bytes(_PROBE_BYTES))
    except OSError as error:
        return _FULL.get(error.errno or 0)
    return None


def recorded_bytes(raw: Path) -> int:
    """Return the size of the raw logs in a folder."""
    return sum(path.stat().st_size for path in raw.glob("*.bin"))


def memory_kills() -> int:
    """Return how many processes the kernel has killed for lack of memory so far; 0 if it does not say."""
    try:
        found = re.search(r"^oom_kill (\d+)$", Path("/proc/vmstat").read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        return 0
    return int(found[1]) if found else 0

"""Ctrl-C while a command is being imported ends it with one line."""

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from harness.launch.interrupts import SAME_REQUEST_S, interruptible

SWALLOWING = """
import os, signal
try:
    os.kill(os.getpid(), signal.NUMBER)
except BaseException:
    raise ImportError("as some modules convert it")
"""
COMMAND = """
import sys
from coflight import command
command.COMMANDS["fly"] = command.Command("", "swallowing", "main")
sys.exit(command.main(["fly"]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_during_the_imports_of_a_command_is_one_line(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "swallowing.py").write_text(SWALLOWING.replace("NUMBER", number.name))
    code = f"import sys; sys.path.append({str(tmp_path)!r}){COMMAND}"
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # the tests run below nohup
        code = f"import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL); {code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGINT
    assert (done.stdout, done.stderr) == ("", "coflight fly: broken off before the start\n")


def test_signals_that_follow_at_once_are_the_same_request(monkeypatch: pytest.MonkeyPatch) -> None:
    """As from a closed terminal or a service manager; a later one interrupts again."""
    with interruptible():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        later_s = time.monotonic() + SAME_REQUEST_S
        monkeypatch.setattr("harness.launch.interrupts.time.monotonic", lambda: later_s)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_signal_of_a_closed_terminal_during_the_imports_ends_the_command(tmp_path: Path) -> None:
    """Its line cannot be written then."""
    (tmp_path / "swallowing.py").write_text(SWALLOWING.replace("NUMBER", "SIGTERM"))
    code = f"import os, sys; sys.path.append({str(tmp_path)!r}); os.close(2){COMMAND}".replace(
        "sys.exit(command.main", "command.open_missing = lambda: None; sys.exit(command.main"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == 128 + signal.SIGINT


def test_signals_have_no_effect_when_a_program_has_its_result() -> None:
    with interruptible() as interrupt:
        interrupt.finish()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)


def test_signal_while_the_interpreter_ends_leaves_the_status() -> None:
    """Sent by an object that is deleted with its module."""
    code = """
        import os, signal, sys, types
        sys.argv = ["coflight", "fly"]
        from coflight import command

        class Late:
            def __del__(self, kill=os.kill, pid=os.getpid(), number=signal.SIGTERM):
                kill(pid, number)

        module = types.ModuleType("swallowing")
        module.main, module.late = lambda _: 3, Late()
        sys.modules["swallowing"] = module
        command.COMMANDS["fly"] = command.Command("", "swallowing", "main")
        sys.exit(command.main())
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "", "")

"""Compiles kernels in a test session, with progress on pytest's terminal."""

import contextlib
import io
import sys
from collections.abc import Mapping

import pytest
from rich.console import Console

from harness.cli.progress import LineDisplay
from harness.launch import kernel_cache, pytest_settings
from harness.launch.kernel_cache import CompileProgress
from harness.launch.run_messages import Compiling


def compile_missing(config: pytest.Config) -> str | None:
    """Compile the kernels that are not cached; returns the line of an error."""
    display = LineDisplay(Console(file=_Terminal(config), highlight=False, markup=False))

    def on_progress(packages: Mapping[str, CompileProgress]) -> None:
        display.on_message(Compiling(packages=packages))

    try:
        kernel_cache.prepare(lambda line: display.note(f"coflight: {line}"), on_progress)
    except kernel_cache.CompileError as error:
        return str(error)
    return None


class _Terminal(io.StringIO):
    """Writes whole lines to pytest's terminal, past its capture of output.

    Of the workers of pytest-xdist, which all wait for the same kernels, only the first one writes.
    """

    def __init__(self, config: pytest.Config) -> None:
        super().__init__()
        self._config = config

    def write(self, text: str, /) -> int:
        worker = pytest_settings.worker(self._config)
        manager = self._config.pluginmanager
        capture, reporter = manager.getplugin("capturemanager"), manager.getplugin("terminalreporter")
        with contextlib.nullcontext() if capture is None else capture.global_and_fixture_disabled():
            if worker == "gw0":  # its stdout is the line to pytest's main process
                sys.stderr.write(f"\n{text}" if sys.stderr.isatty() else text)
                sys.stderr.flush()
            elif worker is None and reporter is not None:
                reporter.ensure_newline()
                reporter.write(text, flush=True)
        return len(text)

"""The viewer's program: whether and where it can be shown, its start on the loopback interface, its end.

Rerun's SDK serves on all interfaces; its program takes an address. The program chooses free ports itself,
and the launcher reads from the kernel what it listens at.
"""

import os
import re
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Self

import msgspec
import psutil

from foundation.records.private_files import write_private
from harness.launch.process_commands import bound_module
from harness.launch.spawner import spawn

START_LIMIT_S = 60.0
"""Wall time within which the program must listen"""
END_LIMIT_S = 3.0
_POLL_S = 0.05
LOOPBACK = "127.0.0.1"
MEMORY_LIMIT = "1GiB"
"""Of what the server keeps for browsers that connect later; the oldest is dropped"""
_PORTS = re.compile(r"web-viewer at http://127\.0\.0\.1:(\d+)|gRPC connections on 127\.0\.0\.1:(\d+)")
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
INSTALL = "the viewer Rerun is not installed: pip install coflight[view]"


class ViewerError(Exception):
    """The viewer cannot be started; the text is one line."""


def check_installed() -> None:
    """Raise ViewerError without Rerun."""
    if find_spec("rerun") is None or find_spec("rerun_cli") is None:
        raise ViewerError(INSTALL)


def has_display() -> bool:
    """Return whether a window can be shown."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def last_line(log: Path) -> str:
    """Return the last line of a log with a text, or an empty text."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), "")


class Viewer:
    """Rerun's viewer as a child of this process: a window, or with ``in_browser`` a server for browsers.

    It ends with this process. ``folder`` is made for its settings and its log. Raises ViewerError, OSError.
    """

    def __init__(self, folder: Path, *, in_browser: bool) -> None:
        check_installed()
        self.in_browser = in_browser
        settings = folder / "rerun"
        settings.mkdir(mode=0o700, parents=True)
        no_analytics = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(settings / "analytics.json"),
            "data_dir_path": str(settings / "analytics"),
        }
        write_private(settings / "analytics.json", msgspec.json.encode(no_analytics))
        arguments = ["--bind", LOOPBACK, "--port", "0", "--hide-welcome-screen"]
        if in_browser:
            arguments += ["--serve-web", "--web-viewer-port", "0", "--server-memory-limit", MEMORY_LIMIT]
        else:
            arguments += ["--expect-data-soon"]
        self._log, self._pages_log = folder / "viewer.log", folder / "pages.log"
        with self._log.open("wb") as output:
            self._process = spawn(
                bound_module("harness.view.viewer_program", *arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                process_group=0,
                env=os.environ | {"XDG_CONFIG_HOME": str(folder.resolve()), "NO_COLOR": "1"},
            )
        self._pages: subprocess.Popen[bytes] | None = None
        try:
            self.web_port, self.port = self._await_ports()
            if in_browser:
                self.web_port = self._serve_pages()
        except BaseException:
            self.close()
            raise

    def _serve_pages(self) -> int:
        """Start the server of the pages; returns its port."""
        ports = map(str, (self.web_port, self.port))
        with self._pages_log.open("wb") as errors:
            self._pages = spawn(
                bound_module("harness.view.page_server", *ports),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                process_group=0,
            )
        assert self._pages.stdout is not None  # noqa: S101  it is PIPE
        line = self._pages.stdout.readline()
        if not line.strip().isdigit():
            raise ViewerError(f"the server of the viewer's pages did not start (log: {self._pages_log})")
        return int(line)

    @property
    def pid(self) -> int:
        """Process id of the program."""
        return self._process.pid

    @property
    def pids(self) -> list[int]:
        """Process ids of all that was started."""
        return [self.pid] if self._pages is None else [self.pid, self._pages.pid]

    @property
    def url(self) -> str:
        """Address for the feed."""
        return f"rerun+http://{LOOPBACK}:{self.port}/proxy"

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        data = f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{self.port}%2Fproxy"
        return f"http://{LOOPBACK}:{self.web_port}/?url={data}&hide_welcome_screen"

    @property
    def is_open(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def _await_ports(self) -> tuple[int, int]:
        """Return the ports of the pages, 0 without, and of the data."""
        deadline_s = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline_s:
            if not self.is_open:
                cause = last_line(self._log) or "it wrote nothing"
                raise ViewerError(f"the viewer did not start: {cause} (log: {self._log})")
            web, data = self._announced()
            expected = {data, web} if self.in_browser else {data}
            if 0 not in expected and expected <= self._listening():
                return web, data
            time.sleep(_POLL_S)
        raise ViewerError(f"the viewer did not start within {START_LIMIT_S:g} s (log: {self._log})")

    def _announced(self) -> tuple[int, int]:
        ports = [0, 0]
        text = _COLOURS.sub("", self._log.read_text(encoding="utf-8", errors="replace"))
        for match in _PORTS.finditer(text):
            for k in (0, 1):
                ports[k] = int(match[k + 1] or ports[k])
        return ports[0], ports[1]

    def _listening(self) -> set[int]:
        """Return the ports that the program itself listens at; ViewerError for another interface."""
        try:
            connections = psutil.Process(self.pid).net_connections("inet")
        except psutil.Error:
            return set()
        listening = [each.laddr for each in connections if each.status == psutil.CONN_LISTEN]
        if other := [address for address in listening if address[0] != LOOPBACK]:
            raise ViewerError(f"the viewer listens at {other[0][0]}, and not only at {LOOPBACK}: it is ended")
        return {address[1] for address in listening}

    def wait(self) -> None:
        """Return when its window is closed, or the server has ended."""
        self._process.wait()

    def close(self) -> None:
        """End the program; harmless when repeated."""
        for process in filter(None, (self._pages, self._process)):
            process.terminate()
        for process in filter(None, (self._pages, self._process)):
            try:
                process.wait(END_LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if self._pages is not None and self._pages.stdout is not None:
            self._pages.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

"""Pages of files in Debian's Chromium, headless with software rendering, without a network."""

import contextlib
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PROGRAM = shutil.which("chromium") or "/usr/bin/chromium"
ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
LIMIT_MS = 60_000


class FilePage:
    """An open page, with the errors of its console and the addresses that it asked a network for."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.set_default_timeout(LIMIT_MS)
        page.on("console", lambda each: self.errors.append(each.text) if each.type == "error" else None)
        page.on("pageerror", lambda each: self.errors.append(str(each)))
        page.on("request", lambda each: self.requests.append(each.url))

    def open(self, path: Path) -> None:
        """Open a file, and wait until its script has run."""
        self.page.goto(path.as_uri())
        self.page.wait_for_function("document.readyState === 'complete'")

    def draw_all(self) -> int:
        """Scroll to every figure until it is drawn; returns their number."""
        figures = self.page.locator(".graph")
        for k in range(figures.count()):
            figures.nth(k).scroll_into_view_if_needed()
            figures.nth(k).locator(".main-svg").first.wait_for(state="attached")
        return int(figures.count())

    def wait_until(self, expression: str) -> None:
        """Wait until an expression is true. Playwright's own wait is forbidden by the page's policy."""
        end_s = time.monotonic() + LIMIT_MS / 1e3
        while not self.page.evaluate(expression):
            assert time.monotonic() < end_s, f"not within {LIMIT_MS / 1e3:.0f} s: {expression}"
            self.page.wait_for_timeout(50.0)

    def foreign_requests(self) -> list[str]:
        """Return the addresses that are neither of files nor made by the page."""
        own = ("file:", "blob:", "data:")
        return [url for url in self.requests if not url.startswith(own)]


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Start Chromium; skips the test without it or without Playwright."""
    playwright = pytest.importorskip("playwright.sync_api")
    if not Path(PROGRAM).exists():
        pytest.skip("without Chromium")
    arguments = [*ARGUMENTS, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    with playwright.sync_playwright() as program:
        started = program.chromium.launch(executable_path=PROGRAM, args=arguments)
        try:
            yield started
        finally:
            started.close()


@contextlib.contextmanager
def file_page(
    started: Any, *, width: int = 1280, height: int = 900, scheme: str = "light"
) -> Iterator[FilePage]:
    """Make a page without a network: offline, and every request but those of files is aborted."""
    context = started.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    context.set_offline(True)
    context.route(lambda url: not url.startswith("file:"), lambda route: route.abort())
    try:
        yield FilePage(context.new_page())
    finally:
        context.close()

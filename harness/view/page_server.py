"""``python -m harness.view.page_server PORT DATA_PORT``: serves the files of the web viewer on loopback only.

They come from Rerun's own server at PORT. This one adds a policy (Content-Security-Policy) by which a browser
loads nothing from elsewhere and sends nothing elsewhere: the web viewer else requests fonts, examples and the
newest version, and sends usage data. It prints the port that it listens at.
"""

import contextlib
import http.client
import shutil
import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar
from urllib.parse import urlsplit

from foundation.processes.scheduling import run_when_idle

LOOPBACK = "127.0.0.1"
FILES = frozenset({"/", "/index.html", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico", "/favicon.svg"})
REQUEST_LIMIT_S = 10.0
"""Wall time from a connection to the end of its request"""
ANSWER_LIMIT_S = 600.0
"""Wall time from the request to the end of its answer, 50 MB, for slow links to another machine"""
STALLED_LIMIT_S = 60.0
"""Wall time within which some of an answer must be sent"""
_COPIED = ("Content-Type", "Content-Length", "Content-Encoding")


def policy(data_port: int) -> str:
    """Return the policy of the pages: all is from this server, and data also from the viewer's."""
    return (
        "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; "
        f"connect-src 'self' blob: data: http://{LOOPBACK}:{data_port}; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class Pages(BaseHTTPRequestHandler):
    """One request of a browser."""

    upstream_port: ClassVar[int]
    data_port: ClassVar[int]
    timeout = STALLED_LIMIT_S

    def handle(self) -> None:
        """Serve the one request of a connection."""
        self._deadline = self._close_after(REQUEST_LIMIT_S)
        try:
            super().handle()
        finally:
            self._deadline.cancel()

    def _close_after(self, limit_s: float) -> threading.Timer:
        """Start a timer that ends reads and writes of this connection."""
        timer = threading.Timer(limit_s, self._shut_down)
        timer.daemon = True
        timer.start()
        return timer

    def _shut_down(self) -> None:
        with contextlib.suppress(OSError):  # it was closed meanwhile
            self.connection.shutdown(socket.SHUT_RDWR)

    def do_GET(self) -> None:
        """Send a file of the viewer."""
        self._deadline.cancel()
        self._deadline = self._close_after(ANSWER_LIMIT_S)
        path = urlsplit(self.path).path
        if path not in FILES:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        upstream = http.client.HTTPConnection(LOOPBACK, self.upstream_port, timeout=STALLED_LIMIT_S)
        try:
            upstream.request("GET", path)
            response = upstream.getresponse()
            self.send_response(response.status)
            for name in _COPIED:
                if (value := response.getheader(name)) is not None:
                    self.send_header(name, value)
            self.send_header("Content-Security-Policy", policy(self.data_port))
            self.end_headers()
            shutil.copyfileobj(response, self.wfile)
        except (ConnectionError, http.client.HTTPException, TimeoutError):
            self.close_connection = True
        finally:
            upstream.close()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002  a name of the base class
        """Log nothing."""


def main() -> None:
    """Serve until the end of the process."""
    run_when_idle()
    Pages.upstream_port, Pages.data_port = int(sys.argv[1]), int(sys.argv[2])
    with ThreadingHTTPServer((LOOPBACK, 0), Pages) as server:
        sys.stdout.write(f"{server.server_address[1]}\n")
        sys.stdout.flush()
        server.serve_forever()


if __name__ == "__main__":
    main()

"""``python -m harness.view.page_server PORT DATA_PORT``: serves the files of the web viewer on loopback only.

They come from Rerun's own server at PORT. This one adds a policy (Content-Security-Policy) by which a browser
loads nothing from elsewhere and sends nothing elsewhere: the web viewer else requests fonts, examples and the
newest version, and sends usage data. It prints the port that it listens at.
"""

import http.client
import shutil
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar
from urllib.parse import urlsplit

from foundation.processes.scheduling import run_when_idle

LOOPBACK = "127.0.0.1"
FILES = frozenset({"/", "/index.html", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico", "/favicon.svg"})
LIMIT_S = 60.0
_COPIED = ("Content-Type", "Content-Length", "Content-Encoding")


def policy(data_port: int) -> str:
    """Return the policy of the pages: all is from this server, and data also from the viewer's."""
    return (
        "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; "
        f"connect-src 'self' blob: data: http://{LOOPBACK}:{data_port}; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class _Pages(BaseHTTPRequestHandler):
    upstream_port: ClassVar[int]
    data_port: ClassVar[int]
    timeout = LIMIT_S

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if path not in FILES:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        upstream = http.client.HTTPConnection(LOOPBACK, self.upstream_port, timeout=LIMIT_S)
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
    _Pages.upstream_port, _Pages.data_port = int(sys.argv[1]), int(sys.argv[2])
    with ThreadingHTTPServer((LOOPBACK, 0), _Pages) as server:
        sys.stdout.write(f"{server.server_address[1]}\n")
        sys.stdout.flush()
        server.serve_forever()


if __name__ == "__main__":
    main()

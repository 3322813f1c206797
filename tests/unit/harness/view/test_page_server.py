"""The server of the viewer's pages: a client that is slow or sends nothing is closed, and blocks no other."""

import http.client
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from harness.view import page_server
from harness.view.page_server import LOOPBACK, Pages

REQUEST_LIMIT_S, ANSWER_LIMIT_S, WAIT_S = 0.5, 1.0, 10.0
CONTENT = bytes(1 << 20)


class Upstream(BaseHTTPRequestHandler):
    """Stands for Rerun's server: a page, and a file that it sends without an end."""

    def do_GET(self):
        self.send_response(200)
        if self.path == "/":
            self.send_header("Content-Length", str(len(CONTENT)))
        self.end_headers()
        self.wfile.write(CONTENT)
        while self.path != "/":
            self.wfile.write(b"x")
            time.sleep(0.02)

    def log_message(self, *_):
        pass


def serving(handler):
    server = ThreadingHTTPServer((LOOPBACK, 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


@pytest.fixture
def port(monkeypatch):
    monkeypatch.setattr(page_server, "REQUEST_LIMIT_S", REQUEST_LIMIT_S)
    monkeypatch.setattr(page_server, "ANSWER_LIMIT_S", ANSWER_LIMIT_S)
    with serving(Upstream) as upstream, serving(Pages) as pages:
        monkeypatch.setattr(Pages, "upstream_port", upstream.server_address[1], raising=False)
        monkeypatch.setattr(Pages, "data_port", 1, raising=False)
        yield pages.server_address[1]
        for server in (pages, upstream):
            server.shutdown()


def page(port):
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=WAIT_S)
    connection.request("GET", "/")
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


def test_a_page_has_the_policy(port):
    answer, content = page(port)
    assert (answer.status, content) == (200, CONTENT)
    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize("drip", [b"", b"x"], ids=["nothing", "one byte at a time"])
def test_a_request_that_does_not_end_is_closed_and_blocks_no_other(port, drip):
    with socket.create_connection((LOOPBACK, port), timeout=WAIT_S) as client:
        client.settimeout(0.05)
        began_s = time.monotonic()
        assert page(port)[0].status == 200
        while time.monotonic() < began_s + WAIT_S:
            try:
                client.sendall(drip)
                if client.recv(1) == b"":
                    break
            except TimeoutError:
                continue
            except ConnectionError:
                break
        assert time.monotonic() - began_s < WAIT_S


def test_an_answer_that_does_not_end_is_closed(port):
    began_s = time.monotonic()
    with socket.create_connection((LOOPBACK, port), timeout=WAIT_S) as client:
        client.sendall(b"GET /favicon.ico HTTP/1.0\r\n\r\n")
        received = sum(map(len, iter(lambda: client.recv(1 << 16), b"")))
    assert received > len(CONTENT) // 2
    assert time.monotonic() - began_s < WAIT_S

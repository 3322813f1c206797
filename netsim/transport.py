"""Questions and answers over Zenoh: the one module that imports it.

One process of a run listens (the 802.11 emulator, as router) and all others connect to it by an explicit
endpoint; there is no scouting, so runs on one machine or network never meet. Everything is a query with a
reply: nothing on the control path can be lost unnoticed.
"""

import os
from collections.abc import Callable

import psutil
import zenoh

RUNTIME = """(
    app: (worker_threads: 1),
    rx: (handover: app), tx: (handover: app), acc: (handover: app), net: (handover: app)
)"""
"""Zenoh's thread pools in one thread: a question then wakes one thread of Zenoh's at each end instead of two
or three. Python is called in threads beside it, one per served key, so that it never waits for Python.
"""


class TransportError(ConnectionError):
    """The endpoint cannot be listened on or reached; the text is one line."""


class Pending:
    """A question under way."""

    def __init__(self, replies: zenoh.handlers.Handler[zenoh.Reply]) -> None:
        self._replies = replies

    def answer(self) -> bytes | None:
        """Wait for the answer, and not for Zenoh's word that no other will follow.

        None when none came within the question's time-out or nobody serves the key.
        """
        for reply in self._replies:  # ends with the query
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
        return None


class Asker:
    """Asks one key again and again; declared once so that each question costs little."""

    def __init__(self, querier: zenoh.Querier) -> None:
        self._querier = querier

    def ask(self, payload: bytes) -> Pending:
        """Send a question; returns at once."""
        return Pending(self._querier.get(payload=payload))


class Question:
    """A question from another process, to be answered once."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.payload: bytes = query.payload.to_bytes() if query.payload is not None else b""

    def answer(self, payload: bytes) -> None:
        """Reply and end the question."""
        self._query.reply(self._query.key_expr, payload)
        self._query.drop()  # type: ignore[no-untyped-call]


class Transport:
    """One process's session. Open it with `listen` or `connect`, close it always."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self.endpoint = endpoint
        """Where others connect to (listener), or where this one is connected."""

    @classmethod
    def listen(cls, host: str, port: int) -> "Transport":
        """Be the run's router on ``host:port``, port 0 being any free one. Raises TransportError."""
        before = _listening_ports()
        try:
            session = zenoh.open(_config("router", "listen", f"tcp/{host}:{port}"))
        except zenoh.ZError as error:
            raise TransportError(f"cannot listen on {host}:{port}: {_first_line(error)}") from None
        if port == 0:
            # Zenoh does not tell which port it was given; this process's new listening socket does.
            (port,) = _listening_ports() - before
        return cls(session, f"tcp/{host}:{port}")

    @classmethod
    def connect(cls, endpoint: str) -> "Transport":
        """Connect to a router's endpoint. Raises TransportError."""
        try:
            return cls(zenoh.open(_config("client", "connect", endpoint)), endpoint)
        except zenoh.ZError as error:
            raise TransportError(f"cannot connect to {endpoint}: {_first_line(error)}") from None

    def asker(self, key: str, *, timeout_s: float, lossy: bool = False) -> Asker:
        """Declare that this process will ask ``key``; an answer may take that long.

        Whoever asks waits while the connection is full; a ``lossy`` question is dropped instead.
        """
        control = zenoh.CongestionControl.DROP if lossy else zenoh.CongestionControl.BLOCK
        return Asker(self._session.declare_querier(key, timeout=timeout_s, congestion_control=control))

    @property
    def connected(self) -> bool:
        """Whether there is a router at the other end; for those that `connect`."""
        return any(True for _ in self._session.info.routers_zid())

    def serve(self, key: str, handler: Callable[[Question], None]) -> None:
        """Answer ``key``.

        The handler is called in a thread of Zenoh's and answers there or hands the question on.
        """
        self._session.declare_queryable(key, lambda query: handler(Question(query)), complete=True)

    def close(self) -> None:
        """End the session; harmless when repeated."""
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]


def _config(mode: str, verb: str, endpoint: str) -> zenoh.Config:
    # Zenoh reads this once, when its first session opens
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5(f"{verb}/endpoints", f'["{endpoint}"]')
    # a listener that is not there is an error now, not something to retry behind the caller's back
    config.insert_json5(f"{verb}/timeout_ms", "2000" if verb == "connect" else "0")
    config.insert_json5(f"{verb}/exit_on_failure", "true")
    # one queue per connection instead of one per priority: all messages here have the same
    config.insert_json5("transport/unicast/qos/enabled", "false")
    return config


def _listening_ports() -> set[int]:
    connections = psutil.Process().net_connections(kind="tcp")
    return {c.laddr.port for c in connections if c.status == psutil.CONN_LISTEN}


def _first_line(error: Exception) -> str:
    """What went wrong, less Zenoh's own source locations."""
    return str(error).split(" at /")[0].splitlines()[0].replace(": [", ": ")

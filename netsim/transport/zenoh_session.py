"""Questions, answers and one-way messages over Zenoh: the one module that imports it.

One process of a run listens (the 802.11 emulator, as router) and all others connect to it by an explicit
endpoint; there is no scouting, so runs on one machine or network never meet.

Who is in lockstep sends one way, for both ends know what has to come, and connects without buffers of Zenoh's
(`Transport.connect`, ``direct``): what was sent is in the receiver's socket when `Sender.send` returns, so
that not even the sender's death loses it. All others ask, and are answered.
"""

import os
import time
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

LONGEST_DIRECT_BYTES = 49_000
"""What a direct connection takes in one message, less than Zenoh's 49 152: it takes nothing to pieces."""
_CHANNEL_MESSAGES = 4_096
_SHORTEST_NAP_S, _LONGEST_NAP_S = 50e-6, 2e-3
"""Between two looks for a message that is late; Zenoh's channels know no time limit."""


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


class TopicSender:
    """Sends to one key again and again, one way, in order, and to whoever listens at the time."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher

    def send(self, payload: bytes) -> None:
        """Send; waits while the connection is full."""
        self._publisher.put(payload)


class Mailbox:
    """What was sent to a key, in its order. Filled beside Python's threads, and read by one of them."""

    def __init__(self, subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> None:
        self._subscriber = subscriber
        self._messages = subscriber.handler

    def take(self, wall_limit_s: float) -> bytes | None:
        """Next message, waiting for it that long at most; None if there is none."""
        sample = self._messages.try_recv()
        if sample is None:
            if wall_limit_s <= 0.0:
                return None
            sample = self._wait(wall_limit_s)
        return None if sample is None else sample.payload.to_bytes()

    def _wait(self, wall_limit_s: float) -> zenoh.Sample | None:
        wall_deadline_s, nap_s = time.monotonic() + wall_limit_s, _SHORTEST_NAP_S
        while (sample := self._messages.try_recv()) is None and time.monotonic() < wall_deadline_s:
            time.sleep(nap_s)
            nap_s = min(2.0 * nap_s, _LONGEST_NAP_S)
        return sample


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
    def connect(cls, endpoint: str, *, direct: bool = False) -> "Transport":
        """Connect to a router's endpoint. Raises TransportError.

        A ``direct`` connection is written to by whoever sends, at either end, in messages of at most
        `LONGEST_DIRECT_BYTES`. It takes half the time, but one that does not read holds up all who send to
        it, so it is for those that everybody waits for anyway.
        """
        try:
            return cls(zenoh.open(_config("client", "connect", endpoint, direct=direct)), endpoint)
        except zenoh.ZError as error:
            raise TransportError(f"cannot connect to {endpoint}: {_first_line(error)}") from None

    def asker(self, key: str, *, timeout_s: float, lossy: bool = False) -> Asker:
        """Declare that this process will ask ``key``; an answer may take that long.

        Whoever asks waits while the connection is full; a ``lossy`` question is dropped instead.
        """
        control = zenoh.CongestionControl.DROP if lossy else zenoh.CongestionControl.BLOCK
        return Asker(self._session.declare_querier(key, timeout=timeout_s, congestion_control=control))

    def sender(self, key: str) -> TopicSender:
        """Declare that this process will send to ``key``."""
        return TopicSender(
            self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        )

    def mailbox(self, key: str) -> Mailbox:
        """Have what is sent to ``key`` from now on kept for this process."""
        return Mailbox(self._session.declare_subscriber(key, zenoh.handlers.FifoChannel(_CHANNEL_MESSAGES)))

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


def _config(mode: str, verb: str, endpoint: str, *, direct: bool = True) -> zenoh.Config:
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
    # a segment of shared memory would stay behind every process, and nothing here is passed by it
    config.insert_json5("transport/shared_memory/enabled", "false")
    # one queue per connection instead of one per priority: all messages here have the same
    config.insert_json5("transport/unicast/qos/enabled", "false")
    # a connection has the mode if both its ends want it: a router's with a guest as Zenoh comes has not
    config.insert_json5("transport/unicast/lowlatency", "true" if direct else "false")
    return config


def _listening_ports() -> set[int]:
    connections = psutil.Process().net_connections(kind="tcp")
    return {c.laddr.port for c in connections if c.status == psutil.CONN_LISTEN}


def _first_line(error: Exception) -> str:
    """What went wrong, less Zenoh's own source locations."""
    return str(error).split(" at /")[0].splitlines()[0].replace(": [", ": ")

"""Queries, replies and one-way messages over Zenoh; the only module that imports Zenoh.

One process of a run listens (the 802.11 emulator, as router), and all others connect to its explicit
endpoint with user and password (`netsim.transport.access_control`). There is no scouting, so runs on one
machine or network are separate. TCP connections are not encrypted.

Processes in lockstep and the host of network interfaces publish one way, over connections without Zenoh's
buffers (`Transport.connect`, ``direct``): the message is in the receiver's socket when `TopicSender.send`
returns, and is not lost even if the sender is killed. All others use queries with replies.
"""

import json
import os
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence

import psutil
import zenoh

from foundation.system_error import in_words
from netsim.transport.access_control import Rights, User, access_control, dictionary

RUNTIME = """(
    app: (worker_threads: 1),
    rx: (handover: app), tx: (handover: app), acc: (handover: app), net: (handover: app)
)"""
"""One thread for all of Zenoh's thread pools: a query wakes one thread at each end instead of two or three.

Python handlers of queries run in other threads, one per served key. Queries wait for them in a buffer that
drops the oldest one when it is full, so this thread does not wait for Python: while it waits, its tasks fill
the memory. Messages of trusted users (`Transport.subscribe`) are handled in this thread, which saves waking
another; all other messages wait until their handlers return.
"""

LONGEST_DIRECT_BYTES = 49_000
"""Longest message of a direct connection, below Zenoh's batch of 49 152 bytes: it does not fragment."""
LONGEST_MESSAGE_BYTES = 4_194_304
"""Longest message that the router puts together; longer ones are dropped."""
CONNECT_LIMIT_S = 60.0
"""Wall time within which the router accepts a client: vehicles of a large swarm all connect at once."""
_BLOCKED_LIMIT_US = 250_000
"""Wall time for which the router waits for a client that does not read, before it disconnects it.

Direct connections, those of vehicles, have no such limit.
"""
_MOST_PENDING = 10_000
"""Connections that the router holds before they have sent a user and password; Zenoh's default is 100."""
_PENDING_LIMIT_MS = 2_000
"""Wall time after which it closes such a connection. A client tries again within `CONNECT_LIMIT_S`."""
_CHANNEL_MESSAGES = 4_096
MOST_WAITING = 64
"""Default number of queries that wait for the handler of a key. Each can hold a receive buffer of 64 KiB."""
_END_LIMIT_S = 5.0
"""Wall time within which handlers have to return when the session is closed."""
_SHORTEST_NAP_S, _LONGEST_NAP_S = 50e-6, 2e-3
"""Polling interval for a late message; Zenoh's channels have no time-out."""


class TransportError(ConnectionError):
    """The endpoint cannot be listened on or reached; the text is one line."""


class Pending:
    """A query whose reply is pending."""

    def __init__(self, replies: zenoh.handlers.Handler[zenoh.Reply]) -> None:
        self._replies = replies

    def answer(self) -> bytes | None:
        """Wait for the first reply and return it; does not wait for the end of the query.

        Returns None without a reply within the time-out or if no process serves the key.
        """
        for reply in self._replies:  # ends with the query
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
        return None


class Asker:
    """Sends queries to one key, declared once to make each query cheap."""

    def __init__(self, querier: zenoh.Querier) -> None:
        self._querier = querier

    def ask(self, payload: bytes) -> Pending:
        """Send a query; return at once."""
        return Pending(self._querier.get(payload=payload))


class TopicSender:
    """Publishes to one key: one way, in order, to all current subscribers."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher

    def send(self, payload: bytes) -> None:
        """Send a message; wait while the connection is full."""
        self._publisher.put(payload)

    def wait_for_receiver(self, wall_limit_s: float) -> bool:
        """Wait until there is a subscriber and return True; False after ``wall_limit_s``.

        Without one, messages of a client are dropped.
        """
        wall_deadline_s = time.monotonic() + wall_limit_s
        while not self._publisher.matching_status:
            if time.monotonic() > wall_deadline_s:
                return False
            time.sleep(_LONGEST_NAP_S)
        return True


class Mailbox:
    """Messages published to a key, in order. Filled by Zenoh, read by one Python thread."""

    def __init__(self, subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> None:
        self._subscriber = subscriber
        self._messages = subscriber.handler

    def take(self, wall_limit_s: float) -> bytes | None:
        """Return the next message, waiting at most ``wall_limit_s``; None without any."""
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
    """A query from another process, which takes one reply."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.payload: bytes = query.payload.to_bytes() if query.payload is not None else b""

    @property
    def key(self) -> str:
        """Key of the query."""
        return str(self._query.key_expr)

    def answer(self, payload: bytes) -> None:
        """Send the reply and end the query."""
        self._query.reply(self._query.key_expr, payload)
        self.drop()

    def drop(self) -> None:
        """End the query without a reply."""
        self._query.drop()  # type: ignore[no-untyped-call]


class Transport:
    """Zenoh session of a process, opened with `listen` or `connect`; to be closed."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self.endpoint = endpoint
        """Endpoint that this process listens on, or is connected to."""
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self._handlers: list[threading.Thread] = []
        # a thread that is still in Zenoh when the interpreter has ended aborts the process
        self._end = weakref.finalize(self, _end, session, self._handlers)

    @classmethod
    def listen(cls, endpoint: str, rights: Sequence[Rights]) -> "Transport":
        """Listen as the run's router for users with these rights; TCP port 0 is any free one.

        Raises TransportError.
        """
        before = _listening_ports()
        try:
            with os.fdopen(os.memfd_create("users"), "w", encoding="ascii") as users:  # no name to be left
                users.write(dictionary(rights))
                users.flush()
                path = f"/proc/self/fd/{users.fileno()}"
                session = zenoh.open(_router_config(endpoint, rights, path))
        except zenoh.ZError as error:
            raise TransportError(f"cannot listen on {endpoint}: {_first_line(error)}") from None
        protocol, _, address = endpoint.partition("/")
        host, _, port = address.rpartition(":")
        if protocol == "tcp" and port == "0":
            # Zenoh does not report the port it was given: find this process's new listening socket.
            (number,) = _listening_ports() - before
            endpoint = f"tcp/{host}:{number}"
        return cls(session, endpoint)

    @classmethod
    def connect(
        cls, endpoint: str, user: User, *, direct: bool = False, limit_s: float = CONNECT_LIMIT_S
    ) -> "Transport":
        """Connect to a router's endpoint.

        Raises TransportError: at once without a listener, after ``limit_s`` if it does not respond or does
        not accept the user.

        On a ``direct`` connection the sending thread writes to the socket, with messages of at most
        `LONGEST_DIRECT_BYTES`. It takes half the time, but a receiver that does not read blocks all senders,
        so it is only for processes in lockstep and the host of network interfaces, without which a run ends.
        """
        _check_listener(endpoint, limit_s)
        config = _config("client", "connect", endpoint, limit_s=limit_s, direct=direct)
        config.insert_json5("transport/auth/usrpwd/user", json.dumps(user.name))
        config.insert_json5("transport/auth/usrpwd/password", json.dumps(user.password))
        try:
            return cls(zenoh.open(config), endpoint)
        except zenoh.ZError:
            raise TransportError(
                f"cannot connect to {endpoint} as {user.name} within {limit_s:g} s: it does not respond, as "
                "when other programs occupy it, or does not accept the password, which may be of another run"
            ) from None

    def asker(self, key: str, *, timeout_s: float, lossy: bool = False) -> Asker:
        """Declare queries to ``key`` with a time-out.

        A query waits while the connection is full; a ``lossy`` query is dropped instead.
        """
        control = zenoh.CongestionControl.DROP if lossy else zenoh.CongestionControl.BLOCK
        return Asker(self._session.declare_querier(key, timeout=timeout_s, congestion_control=control))

    def sender(self, key: str) -> TopicSender:
        """Declare a publisher for ``key``."""
        return TopicSender(
            self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        )

    def mailbox(self, key: str) -> Mailbox:
        """Declare a subscriber that stores messages to ``key`` from now on."""
        return Mailbox(self._session.declare_subscriber(key, zenoh.handlers.FifoChannel(_CHANNEL_MESSAGES)))

    @property
    def connected(self) -> bool:
        """Whether a router is connected; for sessions opened with `connect`."""
        return any(True for _ in self._session.info.routers_zid())

    def serve(
        self, key: str, handler: Callable[[Question], None], *, most_waiting: int = MOST_WAITING
    ) -> None:
        """Serve queries to ``key``.

        The handler is called in a thread of this key; it replies there or passes the query on. At most
        ``most_waiting`` queries wait for it: the oldest are dropped, without a reply.
        """
        waiting: zenoh.handlers.RingChannel[zenoh.Query] = zenoh.handlers.RingChannel(most_waiting)
        queryable = self._session.declare_queryable(key, waiting, complete=True)
        thread = threading.Thread(target=_handle, args=(queryable, handler), name=f"serve {key}", daemon=True)
        self._handlers.append(thread)
        thread.start()

    def subscribe(self, key: str, handler: Callable[[bytes], None]) -> None:
        """Call the handler with each message to ``key`` from now on, in order, in Zenoh's thread.

        All messages of this process wait for the handler, which must not wait for one of them; ``key`` must
        be one that trusted users alone may publish to.
        """

        def on_sample(sample: zenoh.Sample) -> None:
            handler(sample.payload.to_bytes())

        arriving: zenoh.handlers.Callback[zenoh.Sample] = zenoh.handlers.Callback(on_sample, indirect=False)
        self._subscribers.append(self._session.declare_subscriber(key, arriving))

    def close(self) -> None:
        """Close the session, and wait for handlers; repeated calls have no effect."""
        self._end()


def _handle(
    queryable: zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]], handler: Callable[[Question], None]
) -> None:
    """Call the handler for each query until the session is closed."""
    for query in queryable.handler:
        handler(Question(query))


def _end(session: zenoh.Session, threads: Iterable[threading.Thread]) -> None:
    """Close a session, which ends its threads, and wait for them."""
    session.close()  # type: ignore[no-untyped-call]
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(_END_LIMIT_S)


def _router_config(endpoint: str, rights: Sequence[Rights], dictionary_path: str) -> zenoh.Config:
    config = _config("router", "listen", endpoint, limit_s=0.0)
    config.insert_json5("transport/auth/usrpwd/dictionary_file", json.dumps(dictionary_path))
    config.insert_json5("access_control", json.dumps(access_control(rights)))
    # otherwise a hundred connections that send nothing, of any user, lock all clients out
    config.insert_json5("transport/unicast/accept_pending", str(_MOST_PENDING))
    config.insert_json5("transport/unicast/accept_timeout", str(_PENDING_LIMIT_MS))
    config.insert_json5("transport/link/rx/max_message_size", str(LONGEST_MESSAGE_BYTES))
    config.insert_json5(
        "transport/link/tx/queue/congestion_control/block/wait_before_close", str(_BLOCKED_LIMIT_US)
    )
    return config


def _check_listener(endpoint: str, limit_s: float) -> None:
    """Raise TransportError if no process listens at the endpoint: Zenoh would try until its time-out."""
    protocol, _, address = endpoint.partition("/")
    try:
        if protocol == "unixsock-stream":
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
                probe.settimeout(limit_s)
                probe.connect(address)
        elif protocol == "tcp":
            host, _, port = address.rpartition(":")
            socket.create_connection((host, int(port)), timeout=limit_s).close()
    except PermissionError as error:
        raise TransportError(
            f"cannot connect to {endpoint}: {in_words(error)}; the run is another user's"
        ) from None
    except OSError as error:
        raise TransportError(
            f"cannot connect to {endpoint}: {in_words(error)}; the run has ended, or is not on this machine"
        ) from None
    except ValueError as error:
        raise TransportError(f"cannot connect to {endpoint}: {error}") from None


def _config(mode: str, verb: str, endpoint: str, *, limit_s: float, direct: bool = True) -> zenoh.Config:
    # Zenoh reads this once, when it opens the first session
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5(f"{verb}/endpoints", json.dumps([endpoint]))
    # the end of this time is an error
    config.insert_json5(f"{verb}/timeout_ms", str(round(1_000 * limit_s)))
    config.insert_json5(f"{verb}/exit_on_failure", "true")
    # every process would leave a segment of shared memory behind, and it is not used
    config.insert_json5("transport/shared_memory/enabled", "false")
    # one queue per connection instead of one per priority: all messages have the same priority
    config.insert_json5("transport/unicast/qos/enabled", "false")
    # low latency is used if both ends enable it, so not between the router and a guest
    config.insert_json5("transport/unicast/lowlatency", "true" if direct else "false")
    return config


def _listening_ports() -> set[int]:
    connections = psutil.Process().net_connections(kind="tcp")
    return {c.laddr.port for c in connections if c.status == psutil.CONN_LISTEN}


def _first_line(error: Exception) -> str:
    """Return the first line of an error message, without Zenoh's source locations."""
    return str(error).split(" at /")[0].splitlines()[0].replace(": [", ": ")

"""Attacks on ports and sockets with bytes: random ones, and valid messages at a rate. An I/O module."""

import contextlib
import resource
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from ipaddress import IPv4Address

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from studies.attacks.tasks import Address, RandomBytes, Report, SteadyDatagrams

LARGEST_BYTES = 65_507
"""Capacity of UDP over IPv4."""
MOST_SMALL_BYTES = 280
"""Longest of the small datagrams: the longest frame of MAVLink 2."""
STREAM_BYTES = 30_000
"""Bytes of each connection."""
CONNECT_LIMIT_S = 2.0
DESCRIPTORS_BESIDE = 64
"""Descriptors of this program beside its sockets."""
PERIOD_S = 0.002
"""Wall time between two bursts of a steady rate."""
_FIRST_OF_ONE_PORT = IPv4Address("127.1.0.0")
_POOL_BYTES = 4_000_000
_FRAMED = 0.5
"""Share of connections whose bytes are in messages of a length of two bytes, as Zenoh's."""


class _Pool:
    """Random bytes: pieces of one block, since drawing all would take longer than sending them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._block = memoryview(rng.bytes(_POOL_BYTES))

    def piece(self, size: int) -> memoryview:
        """Return ``size`` bytes from a random place."""
        begin = int(self._rng.integers(_POOL_BYTES - size))
        return self._block[begin : begin + size]


def send_random_bytes(task: RandomBytes, ended: threading.Event) -> Report:
    """Send to all ports and sockets in turn, small datagrams first; half of the rest to streams, if any."""
    rng = np.random.default_rng(task.seed)
    pool, counts = _Pool(rng), Counter[str]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        for size, address in _small(rng, task):
            _send(sock, pool.piece(size), address, counts)
            if ended.is_set():
                break
        streams: list[Callable[[], socket.socket]] = [
            *(
                lambda to=address: socket.create_connection(to, CONNECT_LIMIT_S)
                for address in task.streams_to
            ),
            *(lambda to=path: _connected(to) for path in task.sockets),
        ]
        sent_bytes = counts["datagram bytes"]
        turn = 0
        while sent_bytes < task.total_bytes and not ended.is_set():
            if streams and (turn % 2 or not task.datagrams_to):
                sent_bytes += _send_stream(streams[turn // 2 % len(streams)], rng, pool, counts)
            else:
                address = task.datagrams_to[turn // 2 % len(task.datagrams_to)]
                size = int(rng.integers(1, LARGEST_BYTES + 1))
                _send(sock, pool.piece(size), address, counts)
                sent_bytes += size
            turn += 1
    return Report(counts=dict(counts))


def _small(rng: np.random.Generator, task: RandomBytes) -> Iterator[tuple[int, Address]]:
    """Yield the sizes and addresses of the small datagrams."""
    if task.datagrams_to:
        sizes = rng.integers(1, MOST_SMALL_BYTES + 1, task.small_datagrams)
        for number, size in enumerate(sizes.tolist()):
            yield size, task.datagrams_to[number % len(task.datagrams_to)]


def _send(sock: socket.socket, data: memoryview, address: Address, counts: Counter[str]) -> None:
    """Send a datagram, which the kernel drops if the receiver's buffer is full."""
    try:
        sock.sendto(data, address)
    except OSError:
        counts["refused datagrams"] += 1
    counts["datagrams"] += 1
    counts["datagram bytes"] += len(data)


def _connected(path: str) -> socket.socket:
    """Return a connection to a Unix socket. Raises OSError."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.settimeout(CONNECT_LIMIT_S)
        sock.connect(path)
    except OSError:
        sock.close()
        raise
    return sock


def _send_stream(
    connect: Callable[[], socket.socket], rng: np.random.Generator, pool: _Pool, counts: Counter[str]
) -> int:
    """Send bytes over a new connection; return how many were tried."""
    try:
        connection = connect()
    except OSError:
        counts["refused connections"] += 1
        return STREAM_BYTES
    data = bytes(pool.piece(STREAM_BYTES))
    if rng.random() < _FRAMED:
        size = int(rng.integers(1, 2_000))
        data = b"".join(
            size.to_bytes(2, "little") + data[at : at + size] for at in range(0, len(data) - size, size)
        )
    with connection, contextlib.suppress(OSError):  # its peer may close it meanwhile
        connection.settimeout(CONNECT_LIMIT_S)
        connection.sendall(data)
        counts["connections written"] += 1
    counts["stream bytes"] += len(data)
    return len(data)


def send_steadily(task: SteadyDatagrams, ended: threading.Event) -> Report:
    """Send heartbeats of a ground station until the end, in bursts that keep the rate."""
    heartbeat = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    encoder = Encoder(system=255, component=190)
    sent = 0
    with contextlib.ExitStack() as stack:
        count = _allowed(task.sockets)
        bound = _bound_to_one_port(count) if task.one_port else (_bound() for _ in range(count))
        sockets = [stack.enter_context(sock) for sock in bound]
        begin_s = time.monotonic()
        while not ended.wait(PERIOD_S):
            while sent < task.rate_s * (time.monotonic() - begin_s):
                with contextlib.suppress(OSError):
                    sockets[sent % len(sockets)].sendto(encoder.encode(heartbeat), task.datagrams_to)
                sent += 1
        taken_s = time.monotonic() - begin_s
    return Report(counts={"datagrams": sent, "per second": round(sent / taken_s), "sockets": len(sockets)})


def _bound(address: Address = ("127.0.0.1", 0)) -> socket.socket:
    """Return a new socket at an address. Raises OSError."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(address)
    except OSError:
        sock.close()
        raise
    sock.settimeout(0.0)  # what the vehicle sends is not read
    return sock


def _bound_to_one_port(count: int) -> Iterator[socket.socket]:
    """Yield sockets of one port at the addresses from 127.1.0.1 on. Raises OSError if it is taken at one."""
    port = 0
    for number in range(1, count + 1):
        sock = _bound((str(_FIRST_OF_ONE_PORT + number), port))
        port = sock.getsockname()[1]
        yield sock


def _allowed(sockets: int) -> int:
    """Raise the limit of descriptors as far as that many sockets need; return how many are possible."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = sockets + DESCRIPTORS_BESIDE
    if hard != resource.RLIM_INFINITY:
        needed = min(needed, hard)
    if soft != resource.RLIM_INFINITY and soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    return min(sockets, needed - DESCRIPTORS_BESIDE)

"""Attacks on the radio: forged batches, wrong passwords, altered bytes, floods of batches and of names.

An I/O module. `netsim.transport.radio_users` states what each user may do.
"""

import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Iterator

import numpy as np

from netsim.transport.access_control import User
from netsim.transport.lockstep_radio import guest_transmit_key, receive_key, transmit_key
from netsim.transport.zenoh_session import Transport, TransportError
from netsim.wire.messages import Broadcast, Delivery, RxBatch, TxBatch, encode
from studies.attacks.tasks import (
    AlteredConnections,
    BatchFlood,
    ForgedBatches,
    KeyExpressions,
    Login,
    RefusedLogins,
    Report,
)

ANSWER_LIMIT_S = 0.5
CONNECT_LIMIT_S = 10.0
ALTERED_LIMIT_S = 1.0
"""Wall time for which a connection with altered bytes may wait to be accepted."""
ALTERED_SHARE = 0.5
"""Share of its pieces in which bytes are altered, after up to four whole ones."""
BATCHES_EACH = 20
"""Batches over an altered connection."""
_PIECE_BYTES = 65_536


def _session(login: Login, *, limit_s: float = CONNECT_LIMIT_S) -> Transport:
    """Connect as a login's user. Raises TransportError."""
    return Transport.connect(login.endpoint, User(login.user, login.password), limit_s=limit_s)


def _batch(station: int, now_us: int, payload: bytes = b"forged") -> bytes:
    item = Broadcast(seq=99, at_us=now_us, payload=payload)
    return encode(TxBatch(station=station, now_us=now_us, items=(item,)))


def forge_batches(task: ForgedBatches, ended: threading.Event) -> Report:
    """Publish batches of other stations at their keys, and to them, and ask as them; nothing may answer."""
    run_id, others = task.login.run_id, [i for i in range(task.stations) if i != task.station]
    delivery = Delivery(source=0, seq=1, received_ns=1, rssi_dbm=-50.0, payload=b"forged")
    answered, sent = set[str](), 0
    with contextlib.closing(_session(task.login)) as session:
        keys = [transmit_key(run_id), *(receive_key(run_id, i) for i in others)]
        keys += [guest_transmit_key(run_id, i) for i in others]
        senders = {key: session.sender(key) for key in keys}
        askers = {
            key: session.asker(key, timeout_s=ANSWER_LIMIT_S) for key in [*keys, f"coflight/{run_id}/**"]
        }
        asked = False
        while sent < task.count and not ended.is_set():
            now_us = 40_000 * (sent % 500)
            for key, sender in senders.items():
                station = others[sent % len(others)]
                to_station = RxBatch(station=station, release_us=now_us, items=(delivery,))
                sender.send(_batch(station, now_us))
                sender.send(encode(to_station))
                sent += 2
                if not asked and askers[key].ask(_batch(station, now_us)).answer() is not None:
                    answered.add(key)
            if (
                not asked
                and askers[f"coflight/{run_id}/**"].ask(_batch(others[0], now_us)).answer() is not None
            ):
                answered.add("**")
            asked = True
    return Report(
        counts={"batches": sent}, found=[f"{key} answers a forged batch" for key in sorted(answered)]
    )


def try_logins(task: RefusedLogins, ended: threading.Event) -> Report:
    """Try to connect with each login; one that is accepted is a finding."""
    found, refused = list[str](), 0
    for login in task.logins:
        if ended.is_set():
            break
        try:
            _session(login, limit_s=task.limit_s).close()
        except TransportError:
            refused += 1
        else:
            found.append(f"the radio accepts user {login.user!r} with a wrong password")
    return Report(counts={"refused logins": refused}, found=found)


def flood(task: BatchFlood, ended: threading.Event) -> Report:
    """Send batches as queries without reading the replies."""
    sent, payload = 0, _batch(task.station, 0, b"x" * 100)
    with contextlib.closing(_session(task.login)) as session:
        key = guest_transmit_key(task.login.run_id, task.station)
        asker = session.asker(key, timeout_s=CONNECT_LIMIT_S)
        while sent < task.count and not ended.is_set():
            asker.ask(payload)
            sent += 1
    return Report(counts={"messages": sent})


def declare_names(task: KeyExpressions, ended: threading.Event) -> Report:
    """Declare publications at many keys, each of which the router may have to keep."""
    declared = 0
    with contextlib.closing(_session(task.login)) as session:
        kept = []
        while declared < task.count and not ended.is_set():
            kept.append(session.sender(f"coflight/{task.login.run_id}/{declared}"))
            declared += 1
    return Report(counts={"names": len(kept)})


def alter_connections(task: AlteredConnections, ended: threading.Event) -> Report:
    """Connect through a relay that alters bytes to the radio; send batches over what is accepted."""
    counts = Counter[str]()
    for number in range(task.connections):
        if ended.is_set():
            break
        counts["altered connections"] += 1
        rng = np.random.default_rng([task.seed, number])
        with contextlib.suppress(TransportError, OSError), _relay(task.login.endpoint, rng) as endpoint:
            login = Login(
                endpoint=endpoint,
                run_id=task.login.run_id,
                user=task.login.user,
                password=task.login.password,
            )
            with contextlib.closing(_session(login, limit_s=ALTERED_LIMIT_S)) as session:
                counts["accepted"] += 1
                _send_some(session, task)
    return Report(counts=dict(counts))


def _send_some(session: Transport, task: AlteredConnections) -> None:
    key = guest_transmit_key(task.login.run_id, task.station)
    asker = session.asker(key, timeout_s=ANSWER_LIMIT_S)
    for _ in range(BATCHES_EACH):
        asker.ask(_batch(task.station, 0))
    asker.ask(_batch(task.station, 0)).answer()


@contextlib.contextmanager
def _relay(endpoint: str, rng: np.random.Generator) -> Iterator[str]:
    """Yield the endpoint of a relay for one connection, whose bytes to ``endpoint`` are altered."""
    whole_pieces = int(rng.integers(5))
    with socket.create_server(("127.0.0.1", 0)) as listener, contextlib.ExitStack() as stack:
        listener.settimeout(CONNECT_LIMIT_S)

        def run() -> None:
            with contextlib.suppress(OSError):
                while True:  # the client looks first whether anything listens
                    client = stack.enter_context(listener.accept()[0])
                    server = stack.enter_context(_raw(endpoint))
                    threading.Thread(target=_pass_on, args=(server, client, None, 0), daemon=True).start()
                    threading.Thread(
                        target=_pass_on, args=(client, server, rng, whole_pieces), daemon=True
                    ).start()

        threading.Thread(target=run, daemon=True).start()
        yield f"tcp/127.0.0.1:{listener.getsockname()[1]}"


def _raw(endpoint: str) -> socket.socket:
    """Return a connection to an endpoint without Zenoh. Raises OSError."""
    protocol, _, address = endpoint.partition("/")
    if protocol == "tcp":
        host, _, port = address.rpartition(":")
        return socket.create_connection((host, int(port)), CONNECT_LIMIT_S)
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        sock.connect(address)
    except OSError:
        sock.close()
        raise
    return sock


def _pass_on(
    source: socket.socket, sink: socket.socket, rng: np.random.Generator | None, whole_pieces: int
) -> None:
    """Pass bytes on until an end closes, altered by ``rng`` after the first ``whole_pieces`` pieces."""
    with contextlib.suppress(OSError):
        while data := source.recv(_PIECE_BYTES):
            if rng is not None and whole_pieces <= 0 and rng.random() < ALTERED_SHARE:
                changed = bytearray(data)
                for _ in range(int(rng.integers(1, 4))):
                    changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
                data = bytes(changed)
            whole_pieces -= 1
            sink.sendall(data)
    with contextlib.suppress(OSError):
        sink.shutdown(socket.SHUT_WR)

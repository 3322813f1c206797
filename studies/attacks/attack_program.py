"""The program that attacks: ``python -m studies.attacks.attack_program``. Its input is one line, an `Order`.

It prints ``begun`` when it has loaded what it needs and has the user of its order, then one line, a `Report`.
The end of its input ends attacks that last until then, and the program with its report.
"""

import os
import sys
import threading
from collections.abc import Callable
from typing import Any

import msgspec

from studies.attacks import (
    cluster_attacks,
    connection_attacks,
    datagram_attacks,
    file_attacks,
    mavlink_attacks,
    radio_attacks,
)
from studies.attacks.tasks import (
    AlteredConnections,
    BatchFlood,
    ForgedBatches,
    IdleConnections,
    KeyExpressions,
    MutatedMavlink,
    OpenEverything,
    Order,
    RandomBytes,
    RefusedLogins,
    Report,
    RunOnCluster,
    SteadyDatagrams,
)

OTHER_UID = 65_534
"""The unprivileged user and its group."""
BEGUN = "begun"
Perform = Callable[[Any, threading.Event], Report]
PERFORMED_BY: dict[type, Perform] = {
    RandomBytes: datagram_attacks.send_random_bytes,
    MutatedMavlink: mavlink_attacks.send_mutated,
    SteadyDatagrams: datagram_attacks.send_steadily,
    ForgedBatches: radio_attacks.forge_batches,
    RefusedLogins: radio_attacks.try_logins,
    AlteredConnections: radio_attacks.alter_connections,
    BatchFlood: radio_attacks.flood,
    KeyExpressions: radio_attacks.declare_names,
    IdleConnections: connection_attacks.hold_connections,
    OpenEverything: file_attacks.open_everything,
    RunOnCluster: cluster_attacks.try_functions,
}


def change_user(uid: int) -> None:
    """Change the user and the group of this process, without further groups. Raises PermissionError."""
    os.setgroups([])
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)


def main() -> None:
    """Perform the order on standard input."""
    order = msgspec.json.decode(sys.stdin.buffer.readline(), type=Order)
    if order.uid is not None:
        change_user(order.uid)
    ended = threading.Event()
    threading.Thread(target=_await_end, args=(ended,), daemon=True).start()
    sys.stdout.write(f"{BEGUN}\n")
    sys.stdout.flush()
    report = PERFORMED_BY[type(order.task)](order.task, ended)
    sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    sys.stdout.flush()
    os._exit(0)  # without the end of Zenoh's threads, which may wait for a connection


def _await_end(ended: threading.Event) -> None:
    sys.stdin.buffer.read()
    ended.set()


if __name__ == "__main__":
    main()

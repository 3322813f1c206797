"""Packets of unmodified programs in a run, and their lateness, from the details of its processes."""

from collections.abc import Iterable
from typing import Any

from harness.records.outcome import ProcessRecord
from netsim.network.messages import NAME as NETWORK

RADIO = "radio"


def program_packets(processes: Iterable[ProcessRecord]) -> dict[str, Any] | None:
    """Return the packets of a run with network namespaces; None for others, and if a process has failed.

    ``sent`` have entered the channel, ``received`` have reached interfaces, each counted once. Of the
    received, ``late`` came more than `netsim.transport.packet_pace.LATE_MS` after the end of their frame, by
    the wall clock; ``mean_late_ms`` and ``largest_late_ms`` are of all.
    """
    details = {process.name: process.details for process in processes}
    try:
        sent = details[RADIO]["packets"]["sent"]
        lateness = details[NETWORK]["bridge"]["lateness"]
    except KeyError:
        return None
    return {
        "sent": sent,
        "received": lateness["packets"],
        "late": lateness["late"],
        "mean_late_ms": lateness["mean_ms"],
        "largest_late_ms": lateness["largest_ms"],
    }
